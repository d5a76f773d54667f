"""The case of a result in words: its rig, its bodies and laws, its load and time, its text."""

import math

from ringwear_par.cases.case import CHANGED, Case, Ring
from ringwear_par.cases.files.keys import read_keys
from ringwear_par.cases.files.reading import make_case
from ringwear_par.errors import InputError
from ringwear_par.pictures.rig import rig_svg
from ringwear_par.reports.blocks import Block, Lines, Picture, Source, Table
from ringwear_par.results.instants import time_words
from ringwear_par.results.result import Result
from ringwear_par.schedules import quantity_text

_GRIPS = {
    "clamped": "clamped at the face away from the contact",
    "platen": "on a platen that lets its far face widen",
}


def case_words(result: Result) -> list[Block]:
    """Return the case of a result in words and as its text. Not collective.

    Laws are told as the result does: those in files of their own are not run.
    """
    about, text = result.attributes, result.case
    blocks: list[Block] = []
    laws = {body: about.get(f"law_{body}") for body in ("lower", "upper")}
    wear = [(f"wear of {body}", law or "none") for body, law in laws.items() if law is not None]
    try:
        case = None if text.startswith(CHANGED) else _without_laws(text, result.name)
    except InputError:  # of a version that had other keys
        case = None
    if case is None:
        caution = (
            "The stored text does not tell the whole case: only its laws are known for certain."
        )
        blocks.append(Lines([caution]))
    if case is not None:
        words = laws["lower"] or "", laws["upper"] or ""
        alt = "Section of the rig through its axis: bodies, load, rotation, contact"
        drawing = rig_svg(case, words).encode()
        blocks.append(Picture("The rig", drawing, "image/svg+xml", alt))
    rows = wear if case is None else [*_bodies(case), *wear, *_test(case)]
    if rows:
        blocks.append(Table("The case in words", ("what", "how"), rows))
    blocks.append(Source("Case file, as run", text))
    for body, source in result.user_laws.items():
        blocks.append(Source(f"Law of {body}, a file of the user's", source))
    return blocks


def _without_laws(text: str, name: str) -> Case:
    keys = read_keys(text, name)
    return make_case({k: v for k, v in keys.items() if not k.startswith("wear.")}, name)


def _bodies(case: Case) -> list[tuple[str, str]]:
    names = ("lower", "upper")
    return [
        (f"{name} body", _body(ring, section.face_description))
        for name, ring, section in zip(names, case.rings, case.sections, strict=True)
    ]


def _body(ring: Ring, face: str) -> str:
    (inner, outer), (bottom, top) = ring.r, ring.z
    shape = f"ring of radii {inner:g} to {outer:g} mm" if inner else f"disc of radius {outer:g} mm"
    words = [
        f"{shape}, height {top - bottom:g} mm", f"Young's modulus {ring.young:g} MPa",
        f"Poisson's ratio {ring.poisson:g}", _GRIPS[ring.grip], f"contact face: {face}",
    ]  # fmt: skip
    if ring.density is not None:
        words.append(f"density {ring.density:g} g/mm\N{SUPERSCRIPT THREE}")
    return "; ".join(words)


def _test(case: Case) -> list[tuple[str, str]]:
    load, (inner, outer) = case.load, case.contact
    pressed = "nothing"
    if load.force is not None:
        pressed = f"axial force, N: {quantity_text(load.force)}"
        if isinstance(load.force, float):
            pressed = f"axial force {load.force:.6g} N, mean pressure {load.force / case.area:.4g} "
            pressed += "MPa over the nominal annulus"
    elif load.displacement is not None:
        pressed = f"given displacement, mm downwards: {quantity_text(load.displacement)}"
    speed = f"{quantity_text(load.omega)} rad/s"
    if isinstance(load.omega, float):
        speed += f" ({30.0 * load.omega / math.pi:.4g} rpm), "
        speed += f"{0.5 * load.omega * (inner + outer):.4g} mm/s at the mean radius"
    time = case.time
    end = time_words(time.end, time.end)
    steps = f"{time.steps} {time.scheme} steps of {time.step:g} s, {end} in all"
    if time.adaptive:
        steps = f"{end} in adaptive steps of a tolerance of {1e3 * time.tolerance:g} "
        steps += "\N{MICRO SIGN}m of wear"
    return [
        ("friction coefficient", f"{case.friction:g}"), ("load", pressed), ("speed", speed),
        ("time", steps),
        ("contact line", f"{case.line.n} elements from {inner:g} to {outer:g} mm, geometry "
         f"{case.mesh.geometry}"),
    ]  # fmt: skip
