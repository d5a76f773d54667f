"""Warnings about the validity of an answer: printed by ``run``, flagged by ``sweep``."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, IntArray
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

#: histories whose worst states are checked together
_TOGETHER = 64
#: the measures of few elements in contact
_ON_FEW = tuple(map(force_measure, range(1, FEW_ELEMENTS)))
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
        """Look for steps that are too long, once a history. Not collective."""
        if snapshot.step is None or not self._begun:
            numbers = snapshot.numbers.tolist()
            self._long_steps |= {numbers[i]: w for i, w in unstable(snapshot).items()}
        self._begun = True
        return False

    def worst(self, numbers: IntArray) -> dict[str, Sequence[float]]:
        """Return the worst of some histories by name of its measure, ``ENTRIES`` numbers each."""
        infinite = max(map(self._stresses.infinite, numbers.tolist()))
        more = {"reactions": self._balances.reactions(numbers), "infinite_stress": infinite}
        return {
            **self._states.worst(numbers),
            **{name: (*some, *(ENTRIES - len(some)) * (0.0,)) for name, some in more.items()},
        }

    def histories(self, failed: Sequence[bool]) -> list[tuple[ValidityWarning, ...]]:
        """Return the warnings of each history, none of those that have failed."""
        good = [number for number, bad in enumerate(failed) if not bad]
        warnings: list[tuple[ValidityWarning, ...]] = [()] * len(failed)
        first = self._cases[0]
        # those of its rings under a constant force, too
        of_first = tuple(_of_cases(first))
        alike = np.array([case.rings == first.rings for case in self._cases])
        unsuspicious = self._unsuspicious(alike)
        for number in good:
            case = self._cases[number]
            if not unsuspicious[number]:
                warnings[number] = self._of(number)
                continue
            long_steps = self._long_steps.get(number)
            few = () if long_steps is None else (long_steps,)
            steady = isinstance(case.load.force, float) and isinstance(first.load.force, float)
            of_case = of_first if steady else tuple(_of_cases(case))
            warnings[number] = (*few, *implausible_numbers(case), *of_case)
        return warnings

    def _unsuspicious(self, alike: BoolArray) -> BoolArray:
        """Return which histories need not be looked at one by one: the worst of many is well.

        Of some, which have the rings of the first.
        """
        unsuspicious = np.zeros(len(alike), dtype=bool)
        if self._stresses.places(0) is not None:
            return unsuspicious
        # the displacement of one would excuse what others are to be warned of
        first = self._cases[0]
        case = replace(first, load=replace(first.load, force=0.0, displacement=None))
        shallow = np.flatnonzero(alike & ~_is_deep(case, self._states.moved))
        for numbers in np.array_split(shallow, -(-len(alike) // _TOGETHER)):
            if len(numbers) > 1:
                worst = self.worst(numbers)
                known = not math.isnan(worst["reactions"][0])
                unsuspicious[numbers] = known and not any(_of_states(case, worst))
        return unsuspicious

    def _of(self, number: int) -> tuple[ValidityWarning, ...]:
        case, places = self._cases[number], self._stresses.places(number)
        warnings = [self._long_steps[number]] if number in self._long_steps else []
        worst = self.worst(np.array([number]))
        warnings += validity_warnings(case, worst)
        if places is not None:
            for check in OF_STRESSES:
                warnings += check(case, self._stresses, number)
        return tuple(warnings)


def validity_warnings(
    case: Case, worst: Mapping[str, Sequence[float]]
) -> tuple[ValidityWarning, ...]:
    """Return warnings about states of a case that the method is not made for. Not collective.

    Parameters
    ----------
    worst : the worst of its history, see ``Warnings.worst``.
    """
    return (*implausible_numbers(case), *_of_cases(case), *_of_states(case, worst))


def _of_cases(case: Case) -> Iterator[ValidityWarning]:
    """Yield the warnings that follow from a case alone."""
    for check in OF_CASES:
        yield from check(case)


def _of_states(case: Case, worst: Mapping[str, Sequence[float]]) -> Iterator[ValidityWarning]:
    """Yield the warnings about the worst of a history's states."""
    for check in OF_STATES:
        yield from check(case, worst)


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


def _deep_wear(case: Case, worst: Mapping[str, Sequence[float]]) -> Iterator[ValidityWarning]:
    """Yield whether wear or approach were too large for small displacements."""
    moved, time, *_ = worst["moved"]
    if _is_deep(case, moved):
        yield ValidityWarning(
            "large_displacement",
            f"approach or wear of {moved:.3g} mm at t = {time:g} s is more than 5 % of a body's "
            "height: small displacements and the mesh of the unworn bodies no longer hold"
            f"{wear_question(case)}",
        )


def _is_deep(case: Case, moved: Any) -> Any:
    """Tell whether wear or approach, mm, were too large for small displacements."""
    gap = case.smallest_gaps[0] if _is_apart(case) else 0.0  # of which another warning tells
    return moved - gap > _MOST_MOVED * _height(case)


def _height(case: Case) -> float:
    """Return the height of the less high body, mm."""
    return min(ring.z[1] - ring.z[0] for ring in case.rings)


def _never_touches(case: Case) -> bool:
    """Tell whether a displacement ends before the faces meet."""
    displacement = case.load.displacement
    return displacement is not None and largest(displacement) <= case.smallest_gaps[0]


def _is_apart(case: Case) -> bool:
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


def _contact_beyond_mesh(
    case: Case, worst: Mapping[str, Sequence[float]]
) -> Iterator[ValidityWarning]:
    """Yield whether faces may have touched where mesh.contact leaves them out."""
    approach, time, *_ = worst["approach"]
    if any(case.open_ends) and approach > case.smallest_gaps[1]:
        yield ValidityWarning(
            "contact_beyond_mesh",
            f"the approach of {approach:.6g} mm at t = {time:g} s exceeds the smallest gap, "
            f"{case.smallest_gaps[1]:.6g} mm, of the faces outside mesh.contact: the bodies may "
            "touch there too, and this contact is not computed",
        )


def _coarse_mesh(case: Case, worst: Mapping[str, Sequence[float]]) -> Iterator[ValidityWarning]:
    """Yield whether the boundary elements' balances and symmetry ask for a finer mesh."""
    reactions, asymmetry = worst.get("reactions", (0.0, 0.0)), worst["symmetry_defect"]
    layered = any(ring.layers for ring in case.rings)
    measures = [reactions] if layered else [reactions, asymmetry]
    if reactions[0] > _MOST_DEFECT or (not layered and asymmetry[0] > _MOST_ASYMMETRIC):
        defect, time, *_ = max(measures, key=lambda entries: entries[0])
        yield ValidityWarning(
            "coarse_mesh",
            f"balance or symmetry of the boundary elements is wrong by {defect:.2g} at worst, at "
            f"t = {time:g} s: a finer mesh (mesh.contact_elements) or thicker bodies are needed",
        )
    elif layered and asymmetry[0] > _MOST_FILM_DEFECT:
        yield ValidityWarning(
            "coarse_film",
            f"the compliance of bodies with layers is asymmetric by {asymmetry[0]:.2g}, as with "
            "thin films that are soft or nearly incompressible: pressures may be wrong by three "
            "times this number. Compare with a finer mesh (mesh.contact_elements)",
        )


def _high_pressure(case: Case, worst: Mapping[str, Sequence[float]]) -> Iterator[ValidityWarning]:
    """Yield whether a pressure was too high for linear elasticity."""
    pressure, time, *_ = worst["mean_pressure"]
    young = min(material.young for material in case.materials.values())
    if pressure > _MOST_PRESSED * young:
        yield ValidityWarning(
            "high_pressure",
            f"the mean pressure in contact, {pressure:.3g} MPa at t = {time:g} s, is more than a "
            f"tenth of a Young's modulus, {young:g} MPa: elasticity is no longer linear there",
        )


def _few_elements(case: Case, worst: Mapping[str, Sequence[float]]) -> Iterator[ValidityWarning]:
    """Yield whether few elements bore a load that counts among those of the history."""
    most = worst["force"][0]
    for count, name in enumerate(_ON_FEW, start=1):
        force, time, *_ = worst.get(name, (0.0, 0.0))
        if force > _SLIGHT_LOAD * most:
            yield ValidityWarning(
                "few_elements_in_contact",
                f"{count} of {case.line.n} elements are in contact at t = {time:g} s, under "
                f"{force:.4g} N: too few to resolve the contact. Use more elements "
                "(mesh.contact_elements), or put them where contact is (mesh.contact = [r1, r2])",
            )
            return


def _other_stack(case: Case, worst: Mapping[str, Sequence[float]]) -> Iterator[ValidityWarning]:
    """Yield which layers of another modulus were worn that elasticity still has."""
    for i, (body, ring) in enumerate(zip(BODIES, case.rings, strict=True)):
        for number, layer in enumerate(ring.layers):
            below = [*(under.young for under in ring.layers), ring.young][number + 1]
            share, time, *_ = worst.get(worn_share(i, number), (0.0, 0.0))
            if share > _MOST_OF_LAYER and abs(layer.young / below - 1.0) > _OTHER_MODULUS:
                yield ValidityWarning(
                    "worn_layer",
                    f"{100.0 * share:.0f} % of {body}.layers[{number}] is worn off where it bears "
                    f"load at t = {time:g} s, but elasticity is computed with the unworn layer, "
                    f"whose modulus is {layer.young:g} MPa over {below:g} MPa under it. "
                    'mesh.geometry = "updated" follows the wear of layers',
                )


def _unlike_slopes(case: Case, worst: Mapping[str, Sequence[float]]) -> Iterator[ValidityWarning]:
    """Yield whether faces that touched sloped by different angles, or from what elements have."""
    share, time, r, lower, upper, acts = worst["unlike_slopes"]
    if share > _LOAD_ASIDE:
        yield ValidityWarning(
            "unlike_slopes",
            f"{100.0 * share:.2g} % of the load at t = {time:g} s is borne where the direction of "
            f"the pressure is more than {MOST_ANGLE:g} degrees off the normal of a face: at "
            f"r = {r:.6g} mm lower slopes by {lower:.3g}, upper by {upper:.3g} degrees, and the "
            f"pressure acts as on a slope of {acts:.3g} degrees"
            + ('; mesh.geometry = "updated" follows the worn faces' * (not case.follows_wear)),
        )


def _asymmetric(_case: Case, worst: Mapping[str, Sequence[float]]) -> Iterator[ValidityWarning]:
    """Yield whether making the compliance symmetric spoiled pressures."""
    error, time, r, *_ = worst["asymmetry"]
    if error > _MOST_ASYMMETRY:
        yield ValidityWarning(
            "asymmetric_compliance",
            f"the pressure at r = {r:.6g} mm is about {error:.2g} off at t = {time:g} s, because "
            "the compliance matrix was made symmetric: a finer mesh (mesh.contact_elements) or a "
            "milder grading (mesh.grading) is needed",
        )


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


#: warnings that follow from a case alone
OF_CASES: tuple[Callable[[Case], Iterable[ValidityWarning]], ...] = (_apart, _missed_corner)
#: about the measures of ``WorstStates``. A larger measure must not warn less: histories are looked
#: at one by one only where the largest measures of many warn
OF_STATES: tuple[
    Callable[[Case, Mapping[str, Sequence[float]]], Iterable[ValidityWarning]], ...
] = (
    _deep_wear, _contact_beyond_mesh, _high_pressure, _few_elements, _coarse_mesh, _other_stack,
    _unlike_slopes, _asymmetric,
)  # fmt: skip
#: about the stresses of a history, of which the observer has this number
OF_STRESSES: tuple[Callable[[Case, StressObserver, int], Iterable[ValidityWarning]], ...] = (
    _infinite_stress,
    _infinite_at_interfaces,
    _worn_points,
)
