"""Warnings about the validity of an answer: printed by ``run``, flagged by ``sweep``."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.cases.case import SAME_TIME, Case
from ringwear_par.cases.plausible import implausible_numbers, wear_question
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.elasticity.stress.fields import StressHistory, mises
from ringwear_par.errors import ValidityWarning
from ringwear_par.history.checks import (
    ENTRIES,
    FEW_ELEMENTS,
    MOST_ANGLE,
    force_measure,
    worn_share,
)
from ringwear_par.history.stresses import RISING, Stresses
from ringwear_par.schedules import Table, largest

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
#: likewise of the symmetry of a compliance without and with layers: pressures are off by as much at
#: most, under wide flat washers far less, under nearly incompressible films up to three times more
_MOST_ASYMMETRIC, _MOST_ASYMMETRIC_FILM = 3e-3, 5e-3
#: share of the load that faces of unlike slopes may bear
_LOAD_ASIDE = 0.05
#: share of a layer, weighted by load, that is worn off, and relative difference of its modulus from
#: what is below, above which the unworn stack no longer describes the body
_MOST_OF_LAYER, _OTHER_MODULUS = 0.25, 0.1

#: share of the range of a load by which steps may miss it
_SLIGHT_MISS = 0.01
#: the largest of each measure of B histories, (ENTRIES, B) each, see ``checks.Worst``
Measures = Mapping[str, FloatArray]


class Check(NamedTuple):
    """A warning of the histories of B where a mask holds."""

    code: str
    #: (B,) bool
    mask: BoolArray
    #: with names of values in braces
    sentence: str
    #: (B,) each, by name
    values: Mapping[str, Sequence[Any] | FloatArray]


def warnings_of_histories(
    cases: Sequence[Case], worst: Measures, stresses: Stresses, failed: Sequence[bool]
) -> list[tuple[ValidityWarning, ...]]:
    """Return the warnings of each of B histories, none of those that have failed."""
    warnings = [[*implausible_numbers(case), *_of_case(case)] for case in cases]
    for check in _of_states(cases, worst):
        for i in np.flatnonzero(check.mask).tolist():
            values = {name: entries[i] for name, entries in check.values.items()}
            warnings[i].append(ValidityWarning(check.code, check.sentence.format(**values)))
    for number, case in enumerate(cases):
        if case.stress is not None and not failed[number]:
            warnings[number] += _of_stresses(case, stresses, number)
    return [() if bad else tuple(w) for bad, w in zip(failed, warnings, strict=True)]


def _of_case(case: Case) -> Iterator[ValidityWarning]:
    """Yield what is doubted before any state: faces far apart, corners between fixed steps."""
    if _is_apart(case):
        gap, (lower, upper) = case.smallest_gaps[0], case.rings
        text = "the approach begins with that way, the penetration does not"
        if _never_touches(case):
            text = "load.displacement is less at all times: the bodies never touch"
        yield ValidityWarning(
            "bodies_apart",
            f"the unloaded faces are {gap:.4g} mm apart (lower.z ends at {lower.z[1]:g} mm, "
            f"upper.z begins at {upper.z[0]:g} mm): {text}",
        )
    if (corner := _missed_corner(case)) is not None:
        time, load, straight = corner
        noun, unit = ("force", "N") if case.load.displacement is None else ("displacement", "mm")
        yield ValidityWarning(
            "missed_corner",
            f"steps of {case.time.step:g} s pass over the corner of the load at t = {time:g} s: "
            f"the {noun} there is {load:.6g} {unit}, but {straight:.6g} {unit} on the straight "
            "line between the ends of the step. Choose time.step so that a step ends there, or "
            'time.scheme = "adaptive"',
        )


def _missed_corner(case: Case) -> tuple[float, float, float] | None:
    """Return the corner of the load's table that fixed steps pass over, None for none.

    That is its time (s), the load there (N or mm), and what the load would be between both ends of
    the step; of several corners, the one that is missed most.
    """
    load = case.load.displacement if case.load.force is None else case.load.force
    step = case.time.step
    if case.time.adaptive or not isinstance(load, Table):
        return None
    x, y = np.array(load.x), np.array(load.y)
    number = np.floor(x / step + SAME_TIME)
    share = np.clip(x / step - number, 0.0, 1.0)
    straight = (1.0 - share) * load(number * step) + share * load((number + 1.0) * step)
    missed = np.where((x > 0.0) & (x < case.time.end), np.abs(y - straight), 0.0)
    i = int(missed.argmax())
    if missed[i] <= _SLIGHT_MISS * np.ptp(y):
        return None
    return float(x[i]), float(y[i]), float(straight[i])


def _height(case: Case) -> float:
    """Return the height of the less high body, mm."""
    return min(ring.z[1] - ring.z[0] for ring in case.rings)


def _never_touches(case: Case) -> bool:
    """Tell whether a displacement ends before the faces meet."""
    displacement = case.load.displacement
    return displacement is not None and largest(displacement) <= case.smallest_gaps[0]


def _is_apart(case: Case) -> bool:
    """Tell whether the unloaded faces are further apart than is likely meant."""
    touching = case.lower.z[1] == case.upper.z[0] and not any(ring.face for ring in case.rings)
    if touching and case.load.displacement is None:  # in less time
        return False
    return case.smallest_gaps[0] > _MOST_APART * _height(case) or _never_touches(case)


def _of_states(cases: Sequence[Case], measures: Measures) -> Iterator[Check]:
    """Yield what is doubted for the worst states of B histories on one contact pair."""
    none = np.zeros((ENTRIES, len(cases)))
    worst = defaultdict(lambda: none, measures)
    times, _, stable, *_ = worst["instability"]
    yield Check(
        "unstable_explicit_step", times > 1.0,
        "explicit scheme: time.step = {step:.6g} s is {times:.3g} times its stability limit; the "
        "largest stable step on this mesh is {stable:.6g} s, beyond which profiles oscillate",
        {"step": times * stable, "times": times, "stable": stable},
    )  # fmt: skip

    moved, time, *_ = worst["moved"]
    # an initial gap, of which another warning tells, does not count
    gaps = np.array([case.smallest_gaps[0] if _is_apart(case) else 0.0 for case in cases])
    mask = moved - gaps > _MOST_MOVED * np.array([_height(case) for case in cases])
    questions = [wear_question(c) if deep else "" for c, deep in zip(cases, mask, strict=True)]
    yield Check(
        "large_displacement", mask,
        "approach or wear of {moved:.3g} mm at t = {time:g} s is more than 5 % of a body's "
        "height: small displacements and the mesh of the unworn bodies no longer hold{question}",
        {"moved": moved, "time": time, "question": questions},
    )  # fmt: skip

    approach, time, *_ = worst["approach"]
    gaps = np.array([c.smallest_gaps[1] if any(c.open_ends) else np.inf for c in cases])
    yield Check(
        "contact_beyond_mesh", approach > gaps,
        "the approach of {approach:.6g} mm at t = {time:g} s exceeds the smallest gap, {gap:.6g} "
        "mm, of the faces outside mesh.contact: the bodies may touch there too, and this contact "
        "is not computed",
        {"approach": approach, "time": time, "gap": gaps},
    )  # fmt: skip

    pressure, time, *_ = worst["mean_pressure"]
    young = np.array([min(m.young for m in case.materials.values()) for case in cases])
    yield Check(
        "high_pressure", pressure > _MOST_PRESSED * young,
        "the mean pressure in contact, {pressure:.3g} MPa at t = {time:g} s, is more than a tenth "
        "of a Young's modulus, {young:g} MPa: elasticity is no longer linear there",
        {"pressure": pressure, "time": time, "young": young},
    )  # fmt: skip

    few = np.array([worst[force_measure(count)][:2] for count in range(1, FEW_ELEMENTS)])
    heavy = few[:, 0] > _SLIGHT_LOAD * worst["force"][0]
    fewest = heavy.argmax(axis=0)
    force, time = few[fewest, :, np.arange(len(cases))].T
    yield Check(
        "few_elements_in_contact", heavy.any(axis=0),
        f"{{count}} of {cases[0].line.n} elements are in contact at t = {{time:g}} s, under "
        "{force:.4g} N: too few to resolve the contact. Use more elements (mesh.contact_elements), "
        "or put them where contact is (mesh.contact = [r1, r2])",
        {"count": fewest + 1, "time": time, "force": force},
    )  # fmt: skip

    torque, reaction, asymmetry = (worst[name][:2] for name in ("torque", "reaction", "asymmetry"))
    reactions = np.where(torque[0] > reaction[0], torque, reaction)
    layered = any(ring.layers for ring in cases[0].rings)
    asymmetric = asymmetry[0] > (_MOST_ASYMMETRIC_FILM if layered else _MOST_ASYMMETRIC)
    defect, time = np.where(asymmetry[0] > reactions[0], asymmetry, reactions)
    films = ". Under films that are soft or nearly incompressible pressures may be wrong by three "
    films = f"{films}times as much" if layered else ""
    yield Check(
        "coarse_mesh", (reactions[0] > _MOST_DEFECT) | asymmetric,
        "the boundary elements are out of balance, or asymmetric, by {defect:.2g} at worst, at "
        "t = {time:g} s: a finer mesh (mesh.contact_elements) or thicker bodies are needed" + films,
        {"defect": defect, "time": time},
    )  # fmt: skip

    yield from _of_layers(cases, worst)

    share, time, r, lower, upper, acts = worst["unlike_slopes"]
    advice = '; mesh.geometry = "updated" follows the worn faces' * (not cases[0].follows_wear)
    yield Check(
        "unlike_slopes", share > _LOAD_ASIDE,
        f"{{share:.2g}} % of the load at t = {{time:g}} s is borne where the direction of the "
        f"pressure is more than {MOST_ANGLE:g} degrees off the normal of a face: at r = {{r:.6g}} "
        "mm lower slopes by {lower:.3g}, upper by {upper:.3g} degrees, and the pressure acts as "
        f"on a slope of {{acts:.3g}} degrees{advice}",
        {"share": 100.0 * share, "time": time, "r": r, "lower": lower, "upper": upper,
         "acts": acts},
    )  # fmt: skip


def _of_layers(cases: Sequence[Case], worst: Measures) -> Iterator[Check]:
    """Yield which layers of another modulus were worn that elasticity still has."""
    for body, name in enumerate(BODIES):
        young = np.array(
            [[*(layer.young for layer in case.rings[body].layers), case.rings[body].young]
             for case in cases]
        )  # fmt: skip
        for layer, (this, below) in enumerate(zip(young.T[:-1], young.T[1:], strict=True)):
            if worn_share(body, layer) not in worst:  # elements follow the wear
                continue
            share, time, *_ = worst[worn_share(body, layer)]
            other = np.abs(this / below - 1.0) > _OTHER_MODULUS
            yield Check(
                "worn_layer", (share > _MOST_OF_LAYER) & other,
                f"{{share:.0f}} % of {name}.layers[{layer}] is worn off where it bears load at "
                "t = {time:g} s, but elasticity is computed with the unworn layer, whose modulus "
                "is {this:g} MPa over {below:g} MPa under it. "
                'mesh.geometry = "updated" follows the wear of layers',
                {"share": 100.0 * share, "time": time, "this": this, "below": below},
            )  # fmt: skip


def _of_stresses(case: Case, stresses: Stresses, number: int) -> Iterator[ValidityWarning]:
    """Yield what is doubted about the stresses of a history, of which the observer has a number."""
    history, (stress, time, r) = stresses.history(number), stresses.infinite[number]
    assert history is not None
    grows = f"grows as stress.exclude, now {history.exclude:g} mm, is made smaller"
    if stress and time in [state.time for state in history.states]:
        yield ValidityWarning(
            "infinite_stress",
            f"the largest von Mises stress at t = {time:g} s, {stress:.5g} MPa, is beside the "
            f"edge of contact at r = {r:.6g} mm, where stress is infinite until wear has rounded "
            f"the edge: this number {grows}",
        )
    for (body, layer, r), (time, stress, z) in _infinite_ends(case, history).items():
        yield ValidityWarning(
            "infinite_stress_at_interface",
            f"the largest von Mises stress of {body} at t = {time:g} s, {stress:.5g} MPa, is "
            f"beside the free edge of the interface under {body}.layers[{layer}], at r = {r:.6g}, "
            f"z = {z:.6g} mm, where stress between two materials is infinite: this number {grows}",
        )
    yield from _worn_points(case, history, stresses, number)


def _infinite_ends(
    case: Case, history: StressHistory
) -> dict[tuple[str, int, float], tuple[float, float, float]]:
    """Return the free ends of interfaces, where stresses rise, that a largest stress was beside.

    By body, the layer over the interface, and radius (mm): the last time (s), the stress (MPa), and
    the height of the end (mm). Beyond ``stress.exclude`` a few elements are near.
    """
    ends: dict[tuple[str, int, float], tuple[float, float, float]] = {}
    for state in history.states:
        for i, (body, highest) in enumerate(zip(BODIES, state.largest, strict=True)):
            middles, radii = history.interfaces[i].r, case.rings[i].r
            for layer, z in enumerate(history.interfaces[i].z.tolist()):
                values = mises(state.interfaces[i][layer]).max(axis=0)
                for r, end, further in zip(radii, (0, -1), (3, -4), strict=True):
                    reach = history.exclude * (1.0 + 1e-6) + 6.0 * abs(middles[end] - r)
                    near = np.hypot(highest.r - r, highest.z - z) <= reach
                    if r > 0.0 and near and values[end] > RISING * values[further]:
                        ends[body, layer, r] = state.time, highest.mises, z
    return ends


def _worn_points(
    case: Case, history: StressHistory, stresses: Stresses, number: int
) -> Iterator[ValidityWarning]:
    """Yield whether points of stress lie where wear has been at the last of its states.

    Points on faces are of the faces as they are, and points in layers that are worn through have no
    stress: they are left out.
    """
    places, wear = stresses.places, stresses.wear.get(number)
    if places is None or wear is None or case.follows_wear:
        return
    bodies, depths, state = places.of_points, places.depths, history.states[-1]
    under = case.line.element_at(history.points[:, 0])
    worn = np.where(under >= 0, wear[bodies, under], 0.0)
    computed = np.isfinite(state.points).all(axis=1)
    points = np.flatnonzero(computed & (depths > 0.0) & (worn > depths)).tolist()
    if points:
        first, more = points[0], len(points) - 1
        r, z = history.points[first]
        yield ValidityWarning(
            "worn_points",
            f"stress.points[{first}], at r = {r:.6g}, z = {z:.6g} mm, lies {depths[first]:.4g} mm "
            f"under the unworn face of {BODIES[bodies[first]]}, and {worn[first]:.4g} mm is worn "
            f"off there at t = {state.time:g} s"
            + f" ({more} more likewise)" * bool(more)
            + ': with mesh.geometry = "fixed" stresses are those of the unworn shape',
        )
