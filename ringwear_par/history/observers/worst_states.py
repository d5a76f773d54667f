"""The worst of what can make an answer doubtful, over a history or over B of them, and its time.

Every step costs a few sums over the elements: sentences are for the end, see ``results.warnings``.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.arrays import FloatArray, largest
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.mesh import case_slopes
from ringwear_par.elasticity.sections import BODIES

if TYPE_CHECKING:  # opening a result, which has the worst states of its history, starts no MPI
    from ringwear_par.history.physics import Physics
    from ringwear_par.history.snapshots import Snapshot

#: fewer elements in contact than this do not resolve it
FEW_ELEMENTS = 10
#: largest angle (degrees) between faces that touch
MOST_ANGLE = 15.0
#: relative difference of two values of a measure that are the same
_ROUND_OFF = 1e-9
#: numbers of a measure: value, time (s), and up to four that tell where it was
ENTRIES = 6

_MOVED, _APPROACH, _FORCE = "moved", "approach", "force"
_MEAN_PRESSURE, _ASYMMETRY = "mean_pressure", "asymmetry"
_SYMMETRY_DEFECT, _UNLIKE_SLOPES = "symmetry_defect", "unlike_slopes"


def force_measure(count: int) -> str:
    """Return the name of a measure: the largest force (N) on so few elements in contact."""
    return f"force_on_{count}"


def worn_share(body: int, layer: int) -> str:
    """Return the name of a measure: the share of a layer that is worn off, meant by load."""
    return f"worn_share_{BODIES[body]}.layers[{layer}]"


class WorstStates:
    """The largest value of each measure of B histories so far, with its time and place.

    Measures are the approach (mm), the larger of approach and depths of wear (mm), the force (N),
    the mean pressure on the elements in contact (MPa), where they are enough to tell it; the force
    on few elements, see ``force_measure``; the error that a symmetric compliance leaves, with its
    radius (mm); the compliance's symmetry defect; the share of the load between faces of unlike
    slopes, with the radius (mm) where it is largest and the angles there of lower, of upper and of
    the pressure (degrees); and shares of worn layers, see ``worn_share``.

    Parameters
    ----------
    case : the case, or one of B on the same pair.
    count : B.
    """

    def __init__(self, case: Case, count: int = 1) -> None:
        self._sloping = any(ring.face for ring in case.rings)  # wear alone slopes faces apart
        self._layered = [] if case.follows_wear else [i for i in (0, 1) if case.rings[i].layers]
        names = [
            _MOVED, _APPROACH, _FORCE, _MEAN_PRESSURE, _ASYMMETRY, _SYMMETRY_DEFECT,
            _UNLIKE_SLOPES, *map(force_measure, range(1, FEW_ELEMENTS)),
        ]  # fmt: skip
        for i in self._layered:
            names += [worn_share(i, layer) for layer in range(len(case.rings[i].layers))]
        self._rows = {name: row for row, name in enumerate(names)}
        #: (measures, ENTRIES, B)
        self._table = np.zeros((len(names), ENTRIES, count))

    def __call__(self, snapshot: "Snapshot") -> bool:
        """Take new states: an observer. Not collective."""
        if snapshot.passing:
            return False
        physics, state = snapshot.physics, snapshot.state
        places = np.flatnonzero(snapshot.accepted)
        numbers = snapshot.numbers[places]
        contact, wear, time = state.contact, state.wear, state.time
        p, approach, force = contact.pressure, contact.approach, contact.force
        n, bearing = p.shape[1], p > 0.0
        all_bear = bearing.all()
        count = np.full(len(p), n) if all_bear else np.count_nonzero(bearing, axis=1)

        def take(name: str, values: Any, *more: Any) -> None:
            """Take the values (B,) of a measure, and numbers that tell their places."""
            measure, values = self._table[self._rows[name]], values[places]
            # by more than round-off, which would choose the time of what is constant
            worse = values > measure[0, numbers] * (1.0 + _ROUND_OFF)
            if worse.any():
                entries = values, time[places], *(column[places] for column in more)
                for entry, column in enumerate(entries):
                    measure[entry, numbers[worse]] = column[worse]

        take(_APPROACH, approach)
        worn = [i for i in (0, 1) if physics.inputs.laws[i] is not None]
        deepest = [largest(wear[i]) for i in worn]
        take(_MOVED, np.max([approach, *deepest], axis=0))
        take(_FORCE, force)
        enough = count >= min(FEW_ELEMENTS, n)
        area = physics.area_in_contact(p)
        take(_MEAN_PRESSURE, np.divide(force, area, out=np.zeros_like(force), where=enough))
        for few in np.unique(count[~enough & (count > 0)]).tolist():
            take(force_measure(few), np.where(count == few, force, 0.0))
        errors, elements = snapshot.contacts.largest_errors
        take(_ASYMMETRY, errors, physics.line.r[elements])
        take(_SYMMETRY_DEFECT, physics.compliances.symmetry_defect)
        if self._sloping:
            take(_UNLIKE_SLOPES, *_unlike_slopes(physics, p, wear))
        for i in self._layered:
            for layer, share in enumerate(_worn_shares(physics, i, p, wear[i])):
                take(worn_share(i, layer), share)
        return False

    @property
    def measures(self) -> dict[str, FloatArray]:
        """The measures by name, (ENTRIES, B) each."""
        return dict(zip(self._rows, self._table, strict=True))

    def restore(self, before: Mapping[str, Sequence[float]]) -> None:
        """Take the measures that an interrupted single history had."""
        for name in self._rows.keys() & before.keys():
            self._table[self._rows[name], :, 0] = before[name]


def _worn_shares(physics: "Physics", body: int, p: FloatArray, wear: FloatArray) -> FloatArray:
    """Return the shares of a body's layers that are worn off, meant by load, (layers, B).

    Parameters
    ----------
    p, wear : (B, n), MPa and mm.
    """
    ends = physics.layer_ends[body]
    assert ends is not None
    starts = np.concatenate([np.zeros_like(ends[:1]), ends[:-1]])
    load = physics.area * p
    total = load.sum(axis=1)
    shares = [
        np.einsum("bi,bi->b", (np.clip(wear, start, end) - start) / (end - start), load)
        for start, end in zip(starts, ends, strict=True)
    ]
    return np.divide(shares, total, out=np.zeros((len(ends), len(p))), where=total > 0.0)


def _unlike_slopes(physics: "Physics", p: FloatArray, wear: FloatArray) -> tuple[FloatArray, ...]:
    """Return the share of the load between faces of unlike slopes, and where; see ``WorstStates``.

    Slopes are those of the faces now, and the one along whose normal elements have the pressure.

    Parameters
    ----------
    p, wear : (B, n) MPa, (2, B, n) mm.
    """
    line, acts = physics.line, physics.compliances.every[0].slope
    lower, upper = case_slopes(physics.case.sections, line, physics.case.mesh, wear)
    slopes = np.stack([lower, upper, np.broadcast_to(acts, lower.shape)])
    angles = np.degrees(np.arctan(slopes))  # (3, B, n)
    load = line.area * p
    apart = np.where(np.ptp(angles, axis=0) > MOST_ANGLE, load, 0.0)
    total, rows, e = load.sum(axis=1), np.arange(len(p)), apart.argmax(axis=1)
    share = np.divide(apart.sum(axis=1), total, out=np.zeros(len(p)), where=total > 0.0)
    return share, line.r[e], *angles[:, rows, e]
