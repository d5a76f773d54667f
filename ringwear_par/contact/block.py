"""The contacts of B histories of a block, one after another in C, together with wear.

Depths are lines above thresholds, or lines that touch them (Newton's method). An active set and
conjugate gradients on the collocated equations solve each contact, see ``_rows.h``. What is not
solved so is left to PETSc's TAO.
"""

from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.batched import take
from ringwear_par.contact import _rows
from ringwear_par.contact.problem import Compliance, Contact
from ringwear_par.contact.tao import TaoContact
from ringwear_par.wear.step import StepWear

#: touching lines, at most
_LINES = 40
#: residual of responses, over those before
_ROUGH = 0.1
#: residual that is allowed where TAO takes over, see ``TaoContact``
_RESCUED = 1e-6


@dataclass(frozen=True)
class BlockSolver:
    """The contacts of B histories. Not collective.

    Parameters
    ----------
    by_force : whether loads are forces, N; else approaches, mm.
    depth : (B,) mm, error of gaps of elements in contact.
    relative : error of pressures, over the largest of the history.
    """

    compliance: Compliance
    by_force: bool
    depth: FloatArray
    relative: float = 1e-4

    def solve(
        self,
        gap: FloatArray,
        load: FloatArray,
        wear: StepWear | None,
        p: FloatArray,
        d: FloatArray,
    ) -> Contact:
        """Return the contacts at gaps (B, n), from pressures and approaches near them."""
        p, d, rows = p.copy(), d.copy() if self.by_force else load.copy(), np.arange(len(gap))
        failed, iterations = np.zeros(len(gap), bool), np.zeros(len(gap), np.int64)
        lost = np.zeros(len(gap), bool)  # what is no problem at all: a law gives no numbers
        some = self.compliance, self.depth, gap, load, wear
        if self.by_force and load.min() <= 0.0:  # some of the bodies just touch
            lifted = load <= 0.0
            p[lifted], d[lifted], rows = 0.0, gap[lifted].min(axis=1), np.flatnonzero(~lifted)
            some = take(some, rows)
        for _ in range(_LINES):
            if not len(rows):
                break
            (c, depth, gaps, loads, stage), q, e = some, p[rows], d[rows]
            lines = (np.zeros((0, *q.shape)),) * 2 if stage is None else stage.lines(q)
            sets = np.empty(len(rows), np.int32)
            _rows.solve(c, gaps, loads, self.by_force, *lines, self.relative, depth, q, e, sets)
            posed = np.isfinite(gaps.sum(axis=1))
            if stage is not None and not stage.linear:
                posed &= np.isfinite((lines[0] + lines[1]).sum(axis=(0, 2)))
            p[rows], d[rows], lost[rows] = q, e, ~posed
            failed[rows] = (sets < 0) | ~np.isfinite(e)
            iterations[rows] += np.abs(sets)
            if stage is None or stage.linear:
                break
            more = np.flatnonzero(sets > 0)  # of the others, lines were right before
            if 0 < len(more) < len(rows):
                some = take(some, more)
            rows = rows[more]
        else:
            failed[rows] = True
        if (failed & ~lost).any():
            with TaoContact(self.compliance, self.by_force, allowed=_RESCUED) as tao:
                p, d, failed, more = tao.solve(gap, load, wear, p, d, failed & ~lost)
            iterations = iterations + more
        return Contact(p, d, failed | lost, iterations)

    def filtered(self, error: FloatArray, wear: StepWear, p: FloatArray) -> FloatArray:
        """Return what is left of errors of depth (B, n) when pressures have given way to them."""
        const, slope = wear.lines(p)
        slope = slope * (const + slope * p > 0.0)
        slope = slope[0] if len(slope) == 1 else slope.sum(axis=0)
        inverse, relief = (p > 0.0) / (self.compliance.diagonal + slope), np.empty_like(p)
        _rows.respond(self.compliance, self.by_force, inverse, slope, _ROUGH, error.copy(), relief)
        return error + slope * relief
