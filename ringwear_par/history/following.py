"""Elements that follow the wear: when they are meshed anew, and the block and state after it."""

from dataclasses import replace

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.contact.problem import Compliance, Line
from ringwear_par.contact.tao import TaoContact
from ringwear_par.elasticity.bem.pair import UpdatedGeometry
from ringwear_par.elasticity.mesh import ContactLine
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import ComputationError
from ringwear_par.history.block import Block
from ringwear_par.history.elastic import bodies
from ringwear_par.history.schemes import settled
from ringwear_par.history.state import State


class Following:
    """The elasticity of a case whose elements follow the wear. Methods are collective on comm."""

    def __init__(self, case: Case, comm: MPI.Comm) -> None:
        self._tolerance = case.mesh.geometry_tolerance
        self._geometry = UpdatedGeometry(bodies(case), case.line, case.mesh, comm)
        #: (2, n) mm, wear of the profiles that the elements are meshed on
        self._meshed = np.zeros((2, case.line.n))
        self.pair = self._geometry.update(self._meshed)
        #: how often elements were assembled anew, and seconds of it as in ``ContactPair``
        self.updates, self.seconds = 0, np.zeros(2)

    def follow(self, block: Block, solver: TaoContact, state: State) -> tuple[Block, State]:
        """Return the block of elements that have followed the wear of a state, and this state.

        Elements move if the wear since then is more than ``mesh.geometry_tolerance``. It depends on
        the state alone, so that a restarted history does the same. Tries of steps wear about this
        tolerance at most.

        Raises
        ------
        ComputationError : the worn bodies cannot be computed.
        """
        meshed = np.zeros_like(state.wear) if state.meshed is None else state.meshed
        offset = np.zeros_like(block.gap) if state.offset is None else state.offset
        block = self._meshed_on(block, meshed, offset)
        if np.abs(state.wear - meshed).max(initial=0.0) > self._tolerance:
            before, slope = block.compliance.matrix(0), self.pair.slope
            block, meshed = self._meshed_on(block, state.wear, offset), state.wear
            self.updates += 1
            # where a slope has turned, the displacement along the axis under the present pressure
            # jumps, though nothing has moved: the offset takes this jump out of the gap
            jump = state.pressure @ (block.compliance.matrix(0) - before).T
            turned = np.where(self.pair.slope != slope, jump, 0.0)
            block, offset = replace(block, gap=block.gap - turned), offset + turned
            # the rates at the start of the next step are to be those of the new elasticity
            state, failed = settled(block, solver.with_compliance(block.compliance), state)
            if failed.any():
                raise ComputationError("contact: is not solved with the worn geometry")
        with np.errstate(divide="ignore"):
            most = self._tolerance / state.rates.max(axis=(0, 2), initial=0.0)
        length = state.length if block.given_steps else np.minimum(state.length, most)
        return block, replace(state, meshed=meshed, offset=offset, length=length)

    def _meshed_on(self, block: Block, wear: FloatArray, offset: FloatArray) -> Block:
        """Return the block of elements on profiles that are worn, (w, 1, n) mm."""
        both = block.both(wear)[:, 0]
        if np.array_equal(both, self._meshed):
            return block
        case, old = block.cases.every[0], block.compliance
        try:
            self.pair = self._geometry.update(both)
            line = Line.of([self.pair])
            compliance = Compliance.of(line, old.pair, old.softness)
            if not (compliance.diagonal > 0.0).all():
                raise ComputationError("an element of the worn geometry gives way upwards")
        except ComputationError as error:
            raise ComputationError(_slivers(case.line, both) or str(error)) from error
        self._meshed, self.seconds = both, self.seconds + self.pair.seconds
        gap = case.initial_gap[None] - offset
        return replace(block, line=line, compliance=compliance, gap=gap)


def _slivers(line: ContactLine, wear: FloatArray) -> str:
    """Return where a worn face stands out by more than elements are wide; "" for nowhere."""
    rises = np.abs(np.diff(wear, axis=-1))
    steep = rises / np.minimum(line.width[1:], line.width[:-1])
    body, e = np.unravel_index(steep.argmax(), steep.shape)
    if steep[body, e] <= 1.0:
        return ""
    less, more = sorted((e, e + 1), key=lambda place: wear[body, place])
    return (
        f"elements that follow the wear: {BODIES[body]} is worn by {wear[body, more]:.4g} mm at "
        f"r = {line.r[more]:.6g} mm and by {wear[body, less]:.4g} mm at r = {line.r[less]:.6g} mm "
        'beside it: must differ less, or mesh.geometry = "fixed"'
    )
