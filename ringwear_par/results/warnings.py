"""Warnings about the validity of an answer: printed by ``run``, flagged by ``sweep``."""

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.plausible import implausible_numbers, wear_question
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import ValidityWarning
from ringwear_par.history.checks import (
    ENTRIES,
    FEW_ELEMENTS,
    INFINITE_AT_INTERFACE,
    INFINITE_STRESS,
    MOST_ANGLE,
    force_measure,
    worn_share,
)
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
#: a warning of B histories: its code, where it holds (B,), and its sentence there
Check = tuple[str, BoolArray, Callable[[int], str]]


def warnings_of_histories(cases: Sequence[Case], worst: Measures) -> list[list[ValidityWarning]]:
    """Return the warnings of each of B histories."""
    warnings = [[*implausible_numbers(case), *_of_case(case)] for case in cases]
    for code, mask, sentence in _of_states(cases, worst):
        for i in np.flatnonzero(mask).tolist():
            warnings[i].append(ValidityWarning(code, sentence(i)))
    return warnings


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
    load = case.load.displacement if case.load.force is None else case.load.force
    if case.time.adaptive or not isinstance(load, Table):
        return
    ends = case.time.step * np.arange(case.time.steps + 1)
    x, y = np.array(load.x), np.array(load.y)
    straight = np.interp(x, ends, load(ends))  # what steps have at its corners
    missed = np.where((x > 0.0) & (x < case.time.end), np.abs(y - straight), 0.0)
    i = int(missed.argmax())
    if missed[i] > _SLIGHT_MISS * np.ptp(y):
        noun, unit = ("force", "N") if case.load.displacement is None else ("displacement", "mm")
        yield ValidityWarning(
            "missed_corner",
            f"steps of {case.time.step:g} s pass over the corner of the load at t = {x[i]:g} s: "
            f"the {noun} there is {y[i]:.6g} {unit}, but {straight[i]:.6g} {unit} on the straight "
            "line between the ends of the step. Choose time.step so that a step ends there, or "
            'time.scheme = "adaptive"',
        )


def _height(case: Case) -> float:
    """Return the height of the less high body, mm."""
    return min(ring.z[1] - ring.z[0] for ring in case.rings)


def _never_touches(case: Case) -> bool:
    """Tell whether a displacement ends before the faces meet."""
    way = case.load.displacement
    return way is not None and largest(way) <= case.smallest_gaps[0]


def _is_apart(case: Case) -> bool:
    """Tell whether the unloaded faces are further apart than is likely meant."""
    touching = case.lower.z[1] == case.upper.z[0] and not any(ring.face for ring in case.rings)
    if touching and case.load.displacement is None:  # in less time
        return False
    return case.smallest_gaps[0] > _MOST_APART * _height(case) or _never_touches(case)


def _of_states(cases: Sequence[Case], measures: Measures) -> Iterator[Check]:
    """Yield what is doubted for the worst states of B histories on the same contact elements."""
    none = np.zeros((ENTRIES, len(cases)))
    worst = defaultdict(lambda: none, measures)
    times, _, stable, *_ = worst["instability"]
    yield "unstable_explicit_step", times > 1.0, lambda i: (
        f"explicit scheme: time.step = {cases[i].time.step:.6g} s is {times[i]:.3g} times its "
        f"stability limit; the largest stable step on this mesh is {stable[i]:.6g} s, beyond which "
        "profiles oscillate"
    )  # fmt: skip

    moved, when_moved, *_ = worst["moved"]
    # an initial gap, of which another warning tells, does not count
    gaps = np.array([case.smallest_gaps[0] if _is_apart(case) else 0.0 for case in cases])
    heights = np.array([_height(case) for case in cases])
    yield "large_displacement", moved - gaps > _MOST_MOVED * heights, lambda i: (
        f"approach or wear of {moved[i]:.3g} mm at t = {when_moved[i]:g} s is more than 5 % of a "
        "body's height: small displacements and the mesh of the unworn bodies no longer hold"
        f"{wear_question(cases[i])}"
    )  # fmt: skip

    approach, when_closest, *_ = worst["approach"]
    outside = np.array([c.smallest_gaps[1] if any(c.open_ends) else np.inf for c in cases])
    yield "contact_beyond_mesh", approach > outside, lambda i: (
        f"the approach of {approach[i]:.6g} mm at t = {when_closest[i]:g} s exceeds the smallest "
        f"gap, {outside[i]:.6g} mm, of the faces outside mesh.contact: the bodies may touch there "
        "too, and this contact is not computed"
    )  # fmt: skip

    pressure, when_pressed, *_ = worst["mean_pressure"]
    young = np.array([min(m.young for m in case.materials.values()) for case in cases])
    yield "high_pressure", pressure > _MOST_PRESSED * young, lambda i: (
        f"the mean pressure in contact, {pressure[i]:.3g} MPa at t = {when_pressed[i]:g} s, is "
        f"more than a tenth of a Young's modulus, {young[i]:g} MPa: elasticity is no longer linear "
        "there"
    )  # fmt: skip

    few = np.array([worst[force_measure(count)][:2] for count in range(1, FEW_ELEMENTS)])
    heavy = few[:, 0] > _SLIGHT_LOAD * worst["carried"][0]
    fewest = heavy.argmax(axis=0)
    yield "few_elements_in_contact", heavy.any(axis=0), lambda i: (
        f"{fewest[i] + 1} of {cases[0].line.n} elements are in contact at t = "
        f"{few[fewest[i], 1, i]:g} s, under {few[fewest[i], 0, i]:.4g} N: too few to resolve the "
        "contact. Use more elements (mesh.contact_elements), or put them where contact is "
        "(mesh.contact = [r1, r2])"
    )  # fmt: skip

    torque, reaction, asymmetry = (worst[name][:2] for name in ("torque", "reaction", "asymmetry"))
    reactions = np.where(torque[0] > reaction[0], torque, reaction)
    layered = any(ring.layers for ring in cases[0].rings)
    asymmetric = asymmetry[0] > (_MOST_ASYMMETRIC_FILM if layered else _MOST_ASYMMETRIC)
    defect, when_off = np.where(asymmetry[0] > reactions[0], asymmetry, reactions)
    films = ". Under films that are soft or nearly incompressible pressures may be wrong by three "
    films = f"{films}times as much" if layered else ""
    yield "coarse_mesh", (reactions[0] > _MOST_DEFECT) | asymmetric, lambda i: (
        f"the boundary elements are out of balance, or asymmetric, by {defect[i]:.2g} at worst, at "
        f"t = {when_off[i]:g} s: a finer mesh (mesh.contact_elements) or thicker bodies are needed"
        f"{films}"
    )  # fmt: skip

    for body, ring in enumerate(cases[0].rings):
        for layer in range(len(ring.layers)):
            if worn_share(body, layer) in worst:  # elements do not follow the wear
                yield _worn_layer(cases, body, layer, worst[worn_share(body, layer)])

    share, when_aside, r, lower, upper, acts = worst["unlike_slopes"]
    advice = '; mesh.geometry = "updated" follows the worn faces' * (not cases[0].follows_wear)
    yield "unlike_slopes", share > _LOAD_ASIDE, lambda i: (
        f"{100.0 * share[i]:.2g} % of the load at t = {when_aside[i]:g} s is borne where the "
        f"direction of the pressure is more than {MOST_ANGLE:g} degrees off the normal of a face: "
        f"at r = {r[i]:.6g} mm lower slopes by {lower[i]:.3g}, upper by {upper[i]:.3g} degrees, "
        f"and the pressure acts as on a slope of {acts[i]:.3g} degrees{advice}"
    )  # fmt: skip

    exclude = 0.0 if cases[0].stress is None else cases[0].stress.exclude
    grows = f"this number grows as stress.exclude, now {exclude:g} mm, is made smaller"
    at_edge, at_end = worst[INFINITE_STRESS], worst[INFINITE_AT_INTERFACE]
    yield INFINITE_STRESS, at_edge[0] > 0.0, lambda i: (
        f"the largest von Mises stress at t = {at_edge[1, i]:g} s, {at_edge[0, i]:.5g} MPa, is "
        f"beside the edge of contact at r = {at_edge[2, i]:.6g} mm, where stress is infinite until "
        f"wear has rounded the edge: {grows}"
    )  # fmt: skip

    def under(i: int) -> str:
        stress, time, r, z, body, layer = at_end[:, i].tolist()
        name = BODIES[int(body)]
        return (
            f"the largest von Mises stress of {name} at t = {time:g} s, {stress:.5g} MPa, is "
            f"beside the free edge of the interface under {name}.layers[{layer:g}], at "
            f"r = {r:.6g}, z = {z:.6g} mm, where stress between two materials is infinite: {grows}"
        )

    yield INFINITE_AT_INTERFACE, at_end[0] > 0.0, under


def _worn_layer(cases: Sequence[Case], body: int, layer: int, worn: FloatArray) -> Check:
    """Return where a layer of another modulus was worn that elasticity still has."""
    share, time, *_ = worn
    rings = [case.rings[body] for case in cases]
    young = [[*(each.young for each in ring.layers), ring.young] for ring in rings]
    this, below = np.array(young).T[layer : layer + 2]
    mask = (share > _MOST_OF_LAYER) & (np.abs(this / below - 1.0) > _OTHER_MODULUS)
    return "worn_layer", mask, lambda i: (
        f"{100.0 * share[i]:.0f} % of {BODIES[body]}.layers[{layer}] is worn off where it bears "
        f"load at t = {time[i]:g} s, but elasticity is computed with the unworn layer, whose "
        f"modulus is {this[i]:g} MPa over {below[i]:g} MPa under it. "
        'mesh.geometry = "updated" follows the wear of layers'
    )  # fmt: skip
