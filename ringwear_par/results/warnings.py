"""Warnings about the validity of an answer: printed by ``run``, flagged by ``sweep``."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.plausible import implausible_numbers, wear_question
from ringwear_par.cases.schema import SCHEMES
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.elasticity.stress.fields import StressHistory, StressState, mises
from ringwear_par.errors import ValidityWarning
from ringwear_par.history.observers.balances import WorstBalances
from ringwear_par.history.observers.stresses import RISING, StressObserver
from ringwear_par.history.observers.worst_states import (
    ENTRIES,
    FEW_ELEMENTS,
    MOST_ANGLE,
    WorstStates,
    force_measure,
    worn_share,
)
from ringwear_par.history.refusals.stable_steps import missed_corner, stable_steps
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.schedules import largest

#: share of the largest force of a history under which contact need not be resolved
_SLIGHT_LOAD = 0.1
#: largest mean pressure, in Young's moduli, of linear elasticity
_MOST_PRESSED = 0.1
#: largest approach or wear, in heights of a body, that small displacements describe
_MOST_MOVED = 0.05
#: largest gap between the unloaded faces, in heights of a body, that is likely meant
_MOST_APART = 0.01
#: largest defect of the boundary elements' own balances
_MOST_DEFECT = 0.01
#: likewise of the symmetry of a compliance without layers: pressures are off by as much at most,
#: but under wide flat washers and the like, far less
_MOST_ASYMMETRIC = 3e-3
#: and with layers: pressures under nearly incompressible films are off by up to three times as much
_MOST_FILM_DEFECT = 5e-3
#: share of the load that faces of unlike slopes may bear
_LOAD_ASIDE = 0.05
#: largest error of a pressure that comes of making the compliance symmetric
_MOST_ASYMMETRY = 0.05
#: share of a layer, weighted by load, that is worn off, and relative difference of its modulus from
#: what is below, above which the unworn stack no longer describes the body
_MOST_OF_LAYER, _OTHER_MODULUS = 0.25, 0.1


#: name of the measure of largest stresses beside edges where they are infinite
INFINITE = "infinite_stress"
#: the largest of each measure of B histories, (ENTRIES, B) each, see ``WorstStates``
Measures = Mapping[str, FloatArray]
#: numbers of histories, and what is to be said of each
Texts = Iterable[tuple[int, str]]


class Warnings:
    """Warnings of B histories so far: an observer of what other observers do not look at.

    Parameters
    ----------
    cases : of the histories.
    worst, balances, stresses : observers of the same histories.
    """

    def __init__(
        self,
        cases: Sequence[Case],
        worst: WorstStates,
        balances: WorstBalances,
        stresses: StressObserver,
    ) -> None:
        self._cases, self._states, self._balances = cases, worst, balances
        self._stresses = stresses
        self._long_steps: dict[int, ValidityWarning] = {}
        self._begun = False

    def __call__(self, snapshot: Snapshot) -> bool:
        """Look for steps that are too long, once a history."""
        if snapshot.step is None or not self._begun:
            numbers = snapshot.numbers.tolist()
            self._long_steps |= {numbers[i]: w for i, w in unstable(snapshot).items()}
        self._begun = True
        return False

    def measures(self) -> Measures:
        """Return the worst of all histories by name of its measure."""
        more = {name: np.zeros((ENTRIES, len(self._cases))) for name in ("reactions", INFINITE)}
        more["reactions"][:2] = self._balances.reactions
        infinite = [self._stresses.infinite(number) for number in range(len(self._cases))]
        more[INFINITE][:3] = np.transpose(infinite)
        return {**self._states.measures, **more}

    def histories(self, failed: Sequence[bool]) -> list[tuple[ValidityWarning, ...]]:
        """Return the warnings of each history, none of those that have failed."""
        warnings: list[list[ValidityWarning]] = [[] for _ in self._cases]
        for number, case in enumerate(self._cases):
            if number in self._long_steps:
                warnings[number].append(self._long_steps[number])
            warnings[number] += [*implausible_numbers(case), *_apart(case), *_missed_corner(case)]
        measures = self.measures()
        for check, code in OF_STATES.items():
            for number, text in check(self._cases, measures):
                warnings[number].append(ValidityWarning(code, text))
        for number, case in enumerate(self._cases):
            if self._stresses.places(number) is not None and not failed[number]:
                for of_stress in OF_STRESSES:
                    warnings[number] += of_stress(case, self._stresses, number)
        return [() if bad else tuple(w) for bad, w in zip(failed, warnings, strict=True)]


def _where(mask: BoolArray) -> list[int]:
    """Return the numbers of the histories where a mask (B,) holds."""
    return np.flatnonzero(mask).tolist()


def _each(function: Callable[[Case], float], cases: Sequence[Case]) -> FloatArray:
    """Return a number of each case (B,)."""
    return np.array([function(case) for case in cases])


def _missed_corner(case: Case) -> Iterator[ValidityWarning]:
    """Yield whether fixed steps passed over a corner of the load."""
    corner = missed_corner(case)
    if corner is None:
        return
    time, load, straight = corner
    noun, unit = ("force", "N") if case.load.displacement is None else ("displacement", "mm")
    yield ValidityWarning(
        "missed_corner",
        f"steps of {case.time.step:g} s pass over the corner of the load at t = {time:g} s: the "
        f"{noun} there is {load:.6g} {unit}, but {straight:.6g} {unit} on the straight line "
        "between the ends of the step. Choose time.step so that a step ends there, or "
        'time.scheme = "adaptive"',
    )


def _deep_wear(cases: Sequence[Case], worst: Measures) -> Texts:
    """Return where wear or approach were too large for small displacements."""
    moved, time, *_ = worst["moved"]
    most = _MOST_MOVED * _each(_height, cases)
    return {
        i: f"approach or wear of {moved[i]:.3g} mm at t = {time[i]:g} s is more than 5 % of a "
        "body's height: small displacements and the mesh of the unworn bodies no longer hold"
        f"{wear_question(cases[i])}"
        for i in _where(moved > most)
        # an initial gap, of which another warning tells, does not count
        if not _is_apart(cases[i]) or moved[i] - cases[i].smallest_gaps[0] > most[i]
    }.items()


def _height(case: Case) -> float:
    """Return the height of the less high body, mm."""
    return min(ring.z[1] - ring.z[0] for ring in case.rings)


def _never_touches(case: Case) -> bool:
    """Tell whether a displacement ends before the faces meet."""
    displacement = case.load.displacement
    return displacement is not None and largest(displacement) <= case.smallest_gaps[0]


def _is_apart(case: Case) -> bool:
    touching = case.lower.z[1] == case.upper.z[0] and not any(ring.face for ring in case.rings)
    if touching and case.load.displacement is None:  # in less time
        return False
    return case.smallest_gaps[0] > _MOST_APART * _height(case) or _never_touches(case)


def _apart(case: Case) -> Iterator[ValidityWarning]:
    """Yield whether the faces are further apart, before they are pressed, than is likely meant."""
    if not _is_apart(case):
        return
    gap, (lower, upper) = case.smallest_gaps[0], case.rings
    text = (
        f"the unloaded faces are {gap:.4g} mm apart (lower.z ends at {lower.z[1]:g} mm, upper.z "
        f"begins at {upper.z[0]:g} mm): "
    )
    if case.load.displacement is not None and _never_touches(case):
        text += (
            f"load.displacement is {largest(case.load.displacement):.4g} mm at most, so the bodies "
            "never touch and nothing wears"
        )
    else:
        text += "the approach begins with that way, the penetration does not"
    yield ValidityWarning("bodies_apart", text)


def _contact_beyond_mesh(cases: Sequence[Case], worst: Measures) -> Texts:
    """Return where faces may have touched where mesh.contact leaves them out."""
    approach, time, *_ = worst["approach"]
    gap = _each(lambda case: case.smallest_gaps[1] if any(case.open_ends) else np.inf, cases)
    return {
        i: f"the approach of {approach[i]:.6g} mm at t = {time[i]:g} s exceeds the smallest gap, "
        f"{gap[i]:.6g} mm, of the faces outside mesh.contact: the bodies may touch there too, and "
        "this contact is not computed"
        for i in _where(approach > gap)
    }.items()


def _coarse_mesh(cases: Sequence[Case], worst: Measures) -> Texts:
    """Return where the boundary elements' balances and symmetry ask for a finer mesh."""
    reactions, asymmetry = worst["reactions"], worst["symmetry_defect"]
    if any(ring.layers for ring in cases[0].rings):
        (defect, time, *_), asymmetric = reactions, np.zeros(len(cases), dtype=bool)
    else:
        defect, time, *_ = np.where(asymmetry[0] > reactions[0], asymmetry, reactions)
        asymmetric = asymmetry[0] > _MOST_ASYMMETRIC
    return {
        i: f"balance or symmetry of the boundary elements is wrong by {defect[i]:.2g} at worst, at "
        f"t = {time[i]:g} s: a finer mesh (mesh.contact_elements) or thicker bodies are needed"
        for i in _where((reactions[0] > _MOST_DEFECT) | asymmetric)
    }.items()


def _coarse_film(cases: Sequence[Case], worst: Measures) -> Texts:
    """Return where layers make the compliance asymmetric."""
    asymmetry = worst["symmetry_defect"][0]
    layered = any(ring.layers for ring in cases[0].rings)
    found = (asymmetry > _MOST_FILM_DEFECT) & ~(worst["reactions"][0] > _MOST_DEFECT) & layered
    return {
        i: f"the compliance of bodies with layers is asymmetric by {asymmetry[i]:.2g}, as with "
        "thin films that are soft or nearly incompressible: pressures may be wrong by three "
        "times this number. Compare with a finer mesh (mesh.contact_elements)"
        for i in _where(found)
    }.items()


def _high_pressure(cases: Sequence[Case], worst: Measures) -> Texts:
    """Return where a pressure was too high for linear elasticity."""
    pressure, time, *_ = worst["mean_pressure"]
    young = _each(lambda case: min(m.young for m in case.materials.values()), cases)
    return {
        i: f"the mean pressure in contact, {pressure[i]:.3g} MPa at t = {time[i]:g} s, is more "
        f"than a tenth of a Young's modulus, {young[i]:g} MPa: elasticity is no longer linear there"
        for i in _where(pressure > _MOST_PRESSED * young)
    }.items()


def _few_elements(cases: Sequence[Case], worst: Measures) -> Texts:
    """Return where few elements bore a load that counts among those of the history."""
    texts: dict[int, str] = {}
    for count in reversed(range(1, FEW_ELEMENTS)):  # of the fewest in the end
        force, time, *_ = worst[force_measure(count)]
        texts |= {
            i: f"{count} of {cases[i].line.n} elements are in contact at t = {time[i]:g} s, under "
            f"{force[i]:.4g} N: too few to resolve the contact. Use more elements "
            "(mesh.contact_elements), or put them where contact is (mesh.contact = [r1, r2])"
            for i in _where(force > _SLIGHT_LOAD * worst["force"][0])
        }
    return texts.items()


def _other_stack(cases: Sequence[Case], worst: Measures) -> Texts:
    """Yield which layers of another modulus were worn that elasticity still has."""
    for body, name in enumerate(BODIES):
        for number in range(len(cases[0].rings[body].layers)):
            share, time, *_ = worst.get(worn_share(body, number), np.zeros((2, len(cases))))
            for i in _where(share > _MOST_OF_LAYER):
                ring = cases[i].rings[body]
                young, below = [*(layer.young for layer in ring.layers), ring.young][number:][:2]
                text = (
                    f"{100.0 * share[i]:.0f} % of {name}.layers[{number}] is worn off where it "
                    f"bears load at t = {time[i]:g} s, but elasticity is computed with the unworn "
                    f"layer, whose modulus is {young:g} MPa over {below:g} MPa under it. "
                    'mesh.geometry = "updated" follows the wear of layers'
                )
                if abs(young / below - 1.0) > _OTHER_MODULUS:
                    yield i, text


def _unlike_slopes(cases: Sequence[Case], worst: Measures) -> Texts:
    """Return where faces that touched sloped by different angles, or from what elements have."""
    share, time, r, lower, upper, acts = worst["unlike_slopes"]
    return {
        i: f"{100.0 * share[i]:.2g} % of the load at t = {time[i]:g} s is borne where the "
        f"direction of the pressure is more than {MOST_ANGLE:g} degrees off the normal of a face: "
        f"at r = {r[i]:.6g} mm lower slopes by {lower[i]:.3g}, upper by {upper[i]:.3g} degrees, "
        f"and the pressure acts as on a slope of {acts[i]:.3g} degrees"
        + ('; mesh.geometry = "updated" follows the worn faces' * (not cases[i].follows_wear))
        for i in _where(share > _LOAD_ASIDE)
    }.items()


def _asymmetric(_cases: Sequence[Case], worst: Measures) -> Texts:
    """Return where making the compliance symmetric spoiled pressures."""
    error, time, r, *_ = worst["asymmetry"]
    return {
        i: f"the pressure at r = {r[i]:.6g} mm is about {error[i]:.2g} off at t = {time[i]:g} s, "
        "because the compliance matrix was made symmetric: a finer mesh (mesh.contact_elements) or "
        "a milder grading (mesh.grading) is needed"
        for i in _where(error > _MOST_ASYMMETRY)
    }.items()


def _infinite_stress(
    _case: Case, stresses: StressObserver, number: int
) -> Iterator[ValidityWarning]:
    """Yield whether the largest stress was where it would be infinite."""
    history, (stress, time, r) = _stress_history(stresses, number), stresses.infinite(number)
    if stress and time in [state.time for state in history.states]:
        yield ValidityWarning(
            "infinite_stress",
            f"the largest von Mises stress at t = {time:g} s, {stress:.5g} MPa, is beside the "
            f"edge of contact at r = {r:.6g} mm, where stress is infinite until wear has rounded "
            "the edge: this number grows as stress.exclude, now "
            f"{history.exclude:g} mm, is made smaller",
        )


def _worn_points(case: Case, stresses: StressObserver, number: int) -> Iterator[ValidityWarning]:
    """Yield whether points of stress lie where wear has been at the last of its states.

    Points on faces are of the faces as they are, and points in layers that are worn through have no
    stress: they are left out. The wear, (2, n) mm, is of that state; None where it is not known.
    """
    history, places = _stress_history(stresses, number), stresses.places(number)
    wear = stresses.wear(number)
    if wear is None or not wear.any() or case.follows_wear:
        return
    assert case.stress is not None
    assert places is not None
    state, under = history.states[-1], case.line.element_at(history.points[:, 0])
    bodies, depths = places.of_points, places.depths
    worn = np.where(under >= 0, wear[bodies, under], 0.0)
    computed = np.isfinite(state.points).all(axis=1)
    points = np.flatnonzero(computed & (depths > 0.0) & (worn > depths)).tolist()
    if not points:
        return
    first, *more = points
    r, z, _ = case.stress.points[first]
    yield ValidityWarning(
        "worn_points",
        f"stress.points[{first}], at r = {r:.6g}, z = {z:.6g} mm, lies {depths[first]:.4g} mm "
        f"under the unworn face of {BODIES[bodies[first]]}, and {worn[first]:.4g} mm is worn off "
        f"there at t = {state.time:g} s"
        + (f" ({len(more)} more of stress.points likewise)" if more else "")
        + ': with mesh.geometry = "fixed" stresses are those of the unworn shape; with '
        '"updated" a point that is worn away has no stress',
    )


def _infinite_at_interfaces(
    case: Case, stresses: StressObserver, number: int
) -> Iterable[ValidityWarning]:
    """Return a warning for each end of an interface that a largest stress was beside."""
    history = _stress_history(stresses, number)
    warnings: dict[tuple[int, int, float], ValidityWarning] = {}
    for state in history.states:
        for i, (body, highest) in enumerate(zip(BODIES, state.largest, strict=True)):
            for layer, r, z, reach in _infinite_ends(case, history, state, i):
                if np.hypot(highest.r - r, highest.z - z) <= reach:
                    warnings[i, layer, r] = ValidityWarning(
                        "infinite_stress_at_interface",
                        f"the largest von Mises stress of {body} at t = {state.time:g} s, "
                        f"{highest.mises:.5g} MPa, is beside the free edge of the interface "
                        f"under {body}.layers[{layer}], at r = {r:.6g}, z = {z:.6g} mm, where "
                        "stress between two materials is infinite: this number grows as "
                        f"stress.exclude, now {history.exclude:g} mm, is made smaller",
                    )
    return warnings.values()


def _stress_history(stresses: StressObserver, number: int) -> StressHistory:
    history = stresses.history(number)
    assert history is not None
    return history


def _infinite_ends(
    case: Case, history: StressHistory, state: StressState, body: int
) -> Iterator[tuple[int, float, float, float]]:
    """Yield the layer over each interface's free end where stresses rise, its place, and how near.

    All in mm; beyond ``stress.exclude`` a few elements are near.
    """
    middles, stress = history.interfaces[body].r, state.interfaces[body]
    for number, z in enumerate(history.interfaces[body].z):
        values = mises(stress[number]).max(axis=0)
        for r, end, further in zip(case.rings[body].r, (0, -1), (3, -4), strict=True):
            if r > 0.0 and values[end] > RISING * values[further]:
                reach = history.exclude * (1.0 + 1e-6) + 6.0 * abs(middles[end] - r)
                yield number, r, float(z), reach


def unstable(snapshot: Snapshot) -> dict[int, ValidityWarning]:
    """Return which of B histories have explicit steps that are too long."""
    physics = snapshot.physics
    if not SCHEMES[physics.case.time.scheme].explicit:
        return {}
    steps = [case.time.step for case in physics.inputs.cases]
    both = enumerate(zip(steps, stable_steps(physics, snapshot.contacts), strict=True))
    return {i: _unstable(step, limit) for i, (step, limit) in both if step > limit}


def _unstable(step: float, limit: float) -> ValidityWarning:
    return ValidityWarning(
        "unstable_explicit_step",
        f"explicit scheme: time.step = {step:.6g} s is {step / limit:.3g} times its stability "
        f"limit; the largest stable step on this mesh is {limit:.6g} s (beyond it profiles "
        "oscillate, and with p0 > 0 the wear is too large)",
    )


#: about the measures of ``WorstStates``
OF_STATES: dict[Callable[[Sequence[Case], Measures], Texts], str] = {
    _deep_wear: "large_displacement",
    _contact_beyond_mesh: "contact_beyond_mesh",
    _high_pressure: "high_pressure",
    _few_elements: "few_elements_in_contact",
    _coarse_mesh: "coarse_mesh",
    _coarse_film: "coarse_film",
    _other_stack: "worn_layer",
    _unlike_slopes: "unlike_slopes",
    _asymmetric: "asymmetric_compliance",
}
#: about the stresses of a history, of which the observer has this number
OF_STRESSES: tuple[Callable[[Case, StressObserver, int], Iterable[ValidityWarning]], ...] = (
    _infinite_stress,
    _infinite_at_interfaces,
    _worn_points,
)
