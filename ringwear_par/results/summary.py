"""The end of a history in a few lines: what can be wrong with it first, then what it came to."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import CHANGED
from ringwear_par.cases.keys import read_keys
from ringwear_par.cases.schema import BY_PATH
from ringwear_par.cases.values import is_number
from ringwear_par.elasticity.boundary_fields import BODIES
from ringwear_par.errors import LONGEST_SENTENCE, legible
from ringwear_par.results.edge_elements import EDGE_ERROR
from ringwear_par.results.key_numbers import KeyNumbers, WornLayers, key_numbers

if TYPE_CHECKING:
    from ringwear_par.results.result import Result


def summary(result: "Result") -> str:
    """Return a result in a few lines, as ``ringwear run`` prints it. Not collective.

    Raises
    ------
    InputError : the result was stored without its last state.
    """
    found = key_numbers(result)
    assert result.checkpoint is not None
    about, reached = result.attributes, result.checkpoint.numbers
    title = str(result.attributes.get("title", ""))
    last = {name: values[-1] for name, values in result.histories.items()}
    steps = int(reached["step"])
    made = (
        f"{_made(about, reached)}, {result.line.n} contact elements, "
        f"{reached['iterations'] / max(steps, 1):.1f} TAO iterations a step"
    )
    warnings = [f"WARNING: {text}" for text in (*_unfinished(about, reached), *result.doubts)]
    lines = [
        *([title, *warnings, made] if title else [made, *warnings]),
        *_wearing(about),
        *(
            f"{what} of {b}: {about[key]}"
            for what in ("face", "layers")
            for b in ("lower", "upper")
            if (key := f"{what}_{b}") in about
        ),
        *_trust(result),
        f"approach {reached['approach']:.7g} mm, force {reached['force']:.6g} N, "
        f"torque {1e-3 * last['torque']:.6g} N m, "
        f"energy dissipated {1e-3 * last['dissipated_energy']:.6g} J",
        *_pressed(result, found),
        *_stressed(result),
        *_worn(found),
    ]
    if reached["assemblies"]:
        lines.append(f"elements followed the wear {reached['assemblies']} times")
    return "\n".join(legible(line, LONGEST_SENTENCE) for line in lines)


def _made(about: Mapping[str, Any], reached: Mapping[str, Any]) -> str:
    """Return what steps were made."""
    steps, scheme = int(reached["step"]), about.get("scheme", "")
    if scheme in ("implicit", "explicit"):
        return f"{steps} of {about['time_steps']} {scheme} steps of {about['time_step']:g} s"
    repeated = f" (and {reached['rejected']} repeated)" if reached["rejected"] else ""
    return f"{steps} {scheme} steps{repeated} to {reached['time']:g} s".replace("  ", " ")


def _unfinished(about: Mapping[str, Any], reached: Mapping[str, Any]) -> list[str]:
    """Return how far a history is that has not come to its end, nothing if it has."""
    if about["status"] == "complete":
        return []
    where = f"t = {reached['time']:g} of {about.get('time_end', np.nan):g} s"
    if about.get("scheme") in ("implicit", "explicit"):
        where = f"step {int(reached['step'])} of {about['time_steps']}"
    if about.get("error"):
        return [f"failed after {where}: {about['error']}"]
    return [f"stopped after {where}: ringwear run --restart continues it"]


def _wearing(about: Mapping[str, Any]) -> list[str]:
    """Return what each body wears by."""
    laws = {body: about.get(f"law_{body}") for body in ("lower", "upper")}
    if set(laws.values()) == {""}:
        return ["nothing wears"]
    return [f"{body} wears by {law}" for body, law in laws.items() if law]


def _trust(result: "Result") -> list[str]:
    """Return what a history was held against, the worst of all its steps."""
    off, about = result.balances, result.attributes
    identity = ""
    if about.get("energy_identity"):
        by_layer = " by layer" if result.layers else ""
        identity = f", worn volume{by_layer} against energy {off['energy']:.1e}"
    lines = [
        f"relative errors, worst of all steps: contact (KKT) {off['residual']:.1e}, "
        f"force {off['force']:.1e}, "
        f"worn profiles against integrated rates {off['volume']:.1e}{identity}",
        "relative errors of the boundary elements, which vanish with the mesh: force on the fixed "
        f"faces {off['reaction']:.1e}, torque on them {off['torque']:.1e}, "
        f"asymmetry of the compliance matrix {about['symmetry_defect']:.1e} (corrected for)",
    ]
    if "step_error" in off:
        lines.append(_time_stepping(result))
    return lines


def _time_stepping(result: "Result") -> str:
    """Return the estimated error of time stepping, and what it is of."""
    about = result.attributes
    told = f"{_plain(1e3 * result.balances['step_error'])} um{_tolerance(result)}"
    time, when = about.get("step_error_time"), ""
    if about.get("scheme") == "adaptive":
        if time:
            when = f", largest at t = {time:g} s"
        closing = "; closing contact is not in it" if about.get("closing_contact") else ""
        return (
            f"time stepping's error of wear depth, over the whole history: {told}{when}; the "
            f"mesh's error is not in it{closing} (estimate)"
        )
    if time:
        when = f", in the step to t = {time:g} s"
    return (
        f"time stepping's error of wear depth, of one step: {told} at most{when}; neither the "
        "other steps' errors nor the mesh's are in it (estimate)"
    )


def _pressed(result: "Result", found: KeyNumbers) -> list[str]:
    """Return what presses at the end and how far it has slid, in a tribologist's words."""
    element = "of an element"
    if found.largest_beside_edge:
        off = f"{100.0 * EDGE_ERROR:.0f} %"
        element += f" at the edge of contact, whose pressure may be off by {off}"
    lines = [
        f"mean pressure {found.mean_pressure:.4g} MPa over the nominal annulus, largest "
        f"{found.largest_pressure:.4g} MPa at r = {found.largest_at:.6g} mm ({element}), "
        f"smallest {found.smallest_pressure:.4g} MPa; {found.touching} of {result.line.n} elements "
        "in contact"
    ]
    if found.sliding is not None:
        speed, p_v, distance = found.sliding
        lines.append(
            f"at the mean radius: sliding speed {speed:.4g} mm/s, p V {p_v:.4g} MPa mm/s, "
            f"sliding distance {distance:.4g} m"
        )
    return lines


def _stressed(result: "Result") -> list[str]:
    """Return the largest stress of each body and where it is, nothing where none is stored."""
    if result.stress is None or not result.stress.states:
        return []
    state, exclude = result.stress.states[-1], result.stress.exclude
    told = "; ".join(
        f"{body} {of.mises:.5g} MPa at r = {of.r:.6g}, z = {of.z:.6g} mm"
        for body, of in zip(BODIES, state.largest, strict=True)
        if np.isfinite(of.mises)
    )
    when = "" if state.time == result.histories["time"][-1] else f" at t = {state.time:g} s"
    beside = f", {exclude:g} mm and more from edges" if exclude else ""
    by_layer = "".join(
        f"; {body} by layer {_by_layer(values, beside)}"
        for body, values in zip(BODIES, state.layers, strict=True)
        if len(values)
    )
    return [f"largest von Mises stress{when}{beside}: {told or 'none'}{by_layer}"]


def _by_layer(values: FloatArray, beside: str) -> str:
    """Return the largest stress of each layer and the body; NaN where there is no such layer."""
    told = ", ".join(f"{value:.5g}" if np.isfinite(value) else "none" for value in values) + " MPa"
    if np.isnan(values).any():
        told += f" (none: nothing of that layer is left{beside})"
    return told


def _worn(found: KeyNumbers) -> list[str]:
    """Return what has been worn off, how fast, and what of it the penetration is."""
    split = ""
    if found.worn_off is not None:
        split = f": {found.worn_off:.6g} um worn off, {found.elastic:.3g} um elastic"
    lines = [f"penetration {found.penetration:.6g} um{split}"]
    for one in found.bodies:
        told = f"{one.body}: deepest wear {one.deepest:.6g} um"
        told += f", worn volume {one.volume:.6g} mm3"
        if one.mass is not None:
            told += f", mass lost {one.mass:.6g} mg"
        if one.no_mass:
            told += f" ({one.no_mass})"
        if one.rate is not None:
            told += f"; mean depth {one.rate:.4g} um/h, {one.rate_now:.4g} um/h now"
        if one.specific is not None:
            told += f"; specific wear rate {one.specific:.4g} mm3/(N m)"
        lines.append(told)
        if one.layers is not None:
            lines.append(_through(one.body, one.layers))
    return lines


def _through(body: str, layers: WornLayers) -> str:
    """Return what has become of the layers of a body."""
    *of_layers, itself = (f"{volume:.6g}" for volume in layers.volumes)
    several = "layers" if len(of_layers) > 1 else "layer"
    told = (
        f"{several} of {body}: {' + '.join(of_layers)} mm3 worn, of the body itself {itself} mm3; "
    )
    innermost = len(of_layers) - 1
    for one in layers.each:
        if one.layer < innermost:
            told += (
                f"layer {one.layer} worn through over {100.0 * one.share:.4g} % of the contact "
                f"area, first at r = {one.r:.6g} mm, by t = {one.time:.4g} s; "
            )
    together = "all " if innermost else ""
    if layers.time is None:
        nowhere = f"nowhere worn through {together}".rstrip()
        return f"{told}{nowhere}, {layers.thinnest:.4g} um left at least"
    left = f", {layers.thickest:.4g} um left at most" if layers.thickest > 0.0 else ""
    at = "".join(f", at r = {one.r:.6g} mm" for one in layers.each if one.layer == innermost)
    return (
        f"{told}{together}worn through over {100.0 * layers.share:.4g} % of the contact area, "
        f"first at t = {layers.time:.4g} s{at}{left}"
    )


def _plain(value: float) -> str:
    """Return a number in two digits, without an exponent as long as it is not very small."""
    return f"{float(f'{value:.2g}'):g}"


def _tolerance(result: "Result") -> str:
    """Return what the errors of time steps were held to, "" where the stored case does not say."""
    if result.attributes.get("scheme") != "adaptive" or result.case.startswith(CHANGED):
        return ""
    key = BY_PATH["time.tolerance"]
    tolerance = read_keys(result.case).get(key.path, key.default)
    return f" (tolerance {1e3 * tolerance:g} um)" if is_number(tolerance) else ""
