"""What stored states are checked for: balances, and what makes an answer doubtful, at its worst.

Sentences are for the end, see ``results.warnings``.
"""

from collections import defaultdict
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.schema import SCHEMES
from ringwear_par.elasticity.mesh import case_slopes
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.history.block import Block
from ringwear_par.history.layers import layer_volumes
from ringwear_par.history.loop import Instant
from ringwear_par.history.state import State

#: fewer elements in contact than this do not resolve it
FEW_ELEMENTS = 10
#: largest angle (degrees) between faces that touch
MOST_ANGLE = 15.0
#: relative difference of two values of a measure that are the same
_ROUND_OFF = 1e-9
#: measures of a largest stress (MPa) that is beside an edge where it is infinite: of contact, with
#: the radius (mm); the free end of an interface, with radius, height (mm), body and layer above
INFINITE_STRESS, INFINITE_AT_INTERFACE = "infinite_stress", "infinite_stress_at_interface"
#: numbers of a measure: value, time (s), and up to four that tell where it was
ENTRIES = 6


#: relative defects of balances: those of force and energy hold to the accuracy of the contact
#: solver, torque and reaction vanish with the mesh, the step error with the steps
BALANCES = (
    "force",  # contact pressure against the applied force (0 at given displacement)
    "torque",  # on the fixed faces against the friction torque, the worse of both bodies
    "reaction",  # axial force on the fixed faces against that of the pressure, likewise
    "energy",  # worn volume, of all layers, against k times the dissipated energy; 0 where p0 > 0
    # natural residual of the contact, eq. (3), over the largest pressure, as if the wear there is
    # were given: steps in blocks hold to their own, in which wear gives way to pressure as well
    "residual",
    "step_error",  # mm, the error of wear that steps are estimated to make over the history
)
#: those that hold on any mesh, by any steps
_EXACT = ("force", "energy", "residual")


def force_measure(count: int) -> str:
    """Return the name of a measure: the largest force (N) on so few elements in contact."""
    return f"force_on_{count}"


def worn_share(body: int, layer: int) -> str:
    """Return the name of a measure: the share of a layer that is worn off, meant by load."""
    return f"worn_share_{BODIES[body]}.layers[{layer}]"


class Worst:
    """The largest value of each measure of B histories so far, with its time and place.

    Measures are the balances; the approach (mm), the larger of approach and depths of wear (mm),
    the force that is carried (N), the mean pressure on the elements in contact (MPa), where they
    are enough to tell it; the force on few elements, see ``force_measure``; the asymmetry of the
    compliance; the share of the load between faces of unlike slopes, with the radius (mm) where it
    is largest and the angles there of lower, of upper and of the pressure (degrees); shares of worn
    layers; and stresses beside edges, see ``INFINITE_STRESS``.
    """

    def __init__(self, count: int) -> None:
        #: (ENTRIES, B) each, by name
        self.measures = defaultdict[str, FloatArray](lambda: np.zeros((ENTRIES, count)))

    def __call__(self, instant: Instant) -> None:
        """Take new states."""
        block, state = instant.block, instant.state
        for name, values in {**balances(instant), **_measures(block, state)}.items():
            value, *place = values if isinstance(values, tuple) else (values,)
            self.take(name, block.number, value, state.time, *place)

    def take(self, name: str, number: IntArray, value: FloatArray, *place: FloatArray) -> None:
        """Take values of a measure of histories of these numbers, with times and places."""
        measure = self.measures[name]
        # by more than round-off, which would choose the time of what is constant; NaN too
        worse = ~(value <= measure[0, number] * (1.0 + _ROUND_OFF))
        measure[: 1 + len(place), number[worse]] = np.array([value, *place])[:, worse]

    def balances(self, number: int) -> dict[str, float]:
        """Return the worst balances of one history."""
        return {name: float(self.measures[name][0, number]) for name in BALANCES}

    @property
    def imbalance(self) -> FloatArray:
        """(B,) the worst of the balances that hold on any mesh, by any steps."""
        return np.max([self.measures[name][0] for name in _EXACT], axis=0)


def balances(instant: Instant) -> dict[str, Any]:
    """Return the defects of states, see ``BALANCES``, (B,) each."""
    block, state = instant.block, instant.state
    p, line = state.pressure, block.line
    force, friction = p @ line.area, block.moment(p)
    elements = line.pairs[0].line
    turning = elements.arm / elements.uniform_arm  # tractions are constant on elements
    weights = [[*of.force_reaction, *(of.torque_reaction * turning)] for of in line.pairs]
    carried = block.compliance.of_pairs(np.array(weights), p).T
    lower, upper, turned_lower, turned_upper = carried
    asked = block.load.at(state.time) if block.by_force else force
    return {
        "force": _defect(force, asked),
        "torque": np.maximum(_defect(turned_lower, friction), _defect(turned_upper, friction)),
        "reaction": np.maximum(_defect(lower, force), _defect(upper, force)),
        "energy": _energy_defect(block, state),
        "residual": block.compliance.residual(instant.gap, p),
        "step_error": state.error,
    }


def _energy_defect(block: Block, state: State) -> FloatArray:
    """Return how far the energy is off what the worn volumes took of it, (B,).

    0 where a law has no fixed volume by energy, and at paces of its own.
    """
    defect = np.zeros_like(state.energy)
    for body, wear in zip(block.wearing, state.wear, strict=True):
        ratios = body.per_energy
        known = (ratios > 0.0).all(axis=1) & (block.paces is None)
        if known.any():
            took = layer_volumes(block.line.area, body.ends, wear)
            took = np.divide(took, ratios, out=np.zeros_like(took), where=ratios > 0.0).sum(axis=1)
            defect = np.maximum(defect, np.where(known, _defect(took, state.energy), 0.0))
    return defect


def _defect(value: Any, exact: Any) -> Any:
    """Return |value - exact| / exact, 0 where nothing is expected."""
    return _over(abs(value - exact), exact)


def _over(part: Any, whole: Any) -> Any:
    """Return a part over the whole, 0 where that is 0 or less; NaN where either is."""
    return np.divide(part, whole, out=np.zeros_like(whole), where=~(whole <= 0.0))


def _measures(block: Block, state: State) -> dict[str, Any]:
    """Return the measures of states, (B,) each, or tuples of these and their places."""
    p, wear, area = state.pressure, state.wear, block.line.area
    n, bearing = p.shape[1], p > 0.0
    count, force = np.count_nonzero(bearing, axis=1), p @ area
    enough, touching = count >= min(FEW_ELEMENTS, n), bearing @ area
    case = block.cases.every[0]
    measures = {
        "approach": state.approach,
        "moved": np.max([state.approach, *wear.max(axis=2, initial=0.0)], axis=0),
        "carried": force,
        "mean_pressure": np.divide(force, touching, out=np.zeros_like(force), where=enough),
    }
    if not state.time.any():  # it stays, but where elements follow the wear
        measures["asymmetry"] = block.compliance.asymmetry
        if SCHEMES[case.time.scheme].explicit:
            measures["instability"] = instability(block, state)
    for few in np.unique(count[~enough & (count > 0)]).tolist():
        measures[force_measure(few)] = np.where(count == few, force, 0.0)
    if any(ring.face for ring in case.rings):  # wear alone slopes faces apart
        measures["unlike_slopes"] = _unlike_slopes(block, p, wear)
    for body, worn in zip(block.wearing, wear, strict=True):
        starts = np.concatenate([np.zeros_like(body.ends[:1]), body.ends[:-1]])
        for layer, (start, end) in enumerate(zip(starts, body.ends[:-1], strict=False)):
            if not case.follows_wear:
                share = ((np.clip(worn, start, end) - start) / (end - start) * area * p).sum(axis=1)
                measures[worn_share(body.body, layer)] = _over(share, force)
    return measures


def instability(block: Block, state: State) -> tuple[FloatArray, FloatArray]:
    """Return steps of the explicit scheme over the largest stable ones, and these, (B,) 1 and s.

    2 / lambda_max(W C^-1) while all is in contact, of the slopes W of the rates of both bodies
    under the largest load, speed and friction of each history.
    """
    largest, zero = state.pressure.max(axis=1), np.zeros(len(block))
    if block.by_force:
        load = block.load.at(zero)
        largest = largest * np.divide(
            block.load.y.max(axis=1), load, out=zero + 1.0, where=load > 0
        )
    sliding = block.omega.y.max(axis=1), block.friction.y.max(axis=1)
    wear = block.step_wear(state.layer, zero, sliding, state.wear, zero + 1.0)
    slope = np.nan_to_num(wear.lines(np.tile(largest[:, None], block.gap.shape[1]))[1]).sum(axis=0)
    steps = np.array([block.cases.every[i].time.step for i in block.number.tolist()])
    rates = [
        np.linalg.eigvals(np.linalg.solve(block.compliance.matrix(row), np.diag(slopes))).real.max()
        for row, slopes in enumerate(slope)
    ]
    with np.errstate(divide="ignore"):
        stable = 2.0 / np.array(rates)
    return steps / stable, stable


def _unlike_slopes(block: Block, p: FloatArray, wear: FloatArray) -> tuple[FloatArray, ...]:
    """Return the share of the load between faces of unlike slopes, and where; see ``Worst``.

    Slopes are those of the faces now, and the one along whose normal elements have the pressure.
    """
    case, pair = block.cases.every[0], block.line.pairs[0]
    lower, upper = case_slopes(case.sections, pair.line, case.mesh, block.both(wear))
    slopes = np.stack([lower, upper, np.broadcast_to(pair.slope, lower.shape)])
    angles = np.degrees(np.arctan(slopes))  # (3, B, n)
    load = block.line.area * p
    apart = np.where(np.ptp(angles, axis=0) > MOST_ANGLE, load, 0.0)
    rows, e = np.arange(len(p)), apart.argmax(axis=1)
    return _over(apart.sum(axis=1), load.sum(axis=1)), block.line.r[e], *angles[:, rows, e]
