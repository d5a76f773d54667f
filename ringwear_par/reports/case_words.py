"""The case of a result in words: its rig, its bodies and laws, its load and time, its text."""

import re

from ringwear_par.cases.case import CHANGED, Case, Ring
from ringwear_par.cases.files.keys import read_keys
from ringwear_par.cases.files.reading import make_case
from ringwear_par.cases.units import SPECIFIC, factor, in_signs
from ringwear_par.errors import InputError
from ringwear_par.pictures.rig import GRIPS, pressing, rig_svg, turning
from ringwear_par.reports.blocks import Block, Lines, Picture, Source, Table
from ringwear_par.results.key_numbers import time_words
from ringwear_par.results.result import Result
from ringwear_par.schedules import quantity_text

#: a wear coefficient of a law in words
_COEFFICIENT = re.compile(r"(\d\S*) 1/MPa")


def _with_rates(laws: str, friction: float) -> str:
    """Return laws, of layers one by one, with the specific wear rates that their k are."""
    return ", then ".join(_with_rate(law, friction) for law in laws.split(", then "))


def _with_rate(law: str, friction: float) -> str:
    of_energy = " mu " in law
    words = "per friction energy; times mu a specific wear rate of " if of_energy else ""
    unit = (friction if of_energy else 1.0) / factor(SPECIFIC, "1/MPa")

    def rate(k: re.Match[str]) -> str:
        return f"{k[0]} ({words}{unit * float(k[1]):g} {in_signs(SPECIFIC)})"

    return _COEFFICIENT.sub(rate, law)


def case_words(result: Result) -> tuple[list[Block], list[Block]]:
    """Return the drawing of the rig of a result, and its case in words and text. Not collective.

    Laws are described as in the result: those in files of their own are not run.
    """
    about, text = result.attributes, result.case
    rig: list[Block] = []
    blocks: list[Block] = []
    laws = {body: about.get(f"law_{body}") for body in ("lower", "upper")}
    wear = [
        (f"wear of {body}", _with_rates(law, about["friction"]) or "none")
        for body, law in laws.items()
        if law is not None
    ]
    try:
        case = None if text.startswith(CHANGED) else _without_laws(text, result.name)
    except InputError:  # of a version that had other keys
        case = None
    if case is None:
        caution = "The stored text is not the whole case: only its laws are known for certain."
        blocks.append(Lines([caution]))
    if case is not None:
        words = laws["lower"] or "", laws["upper"] or ""
        alt = "Section of the rig through its axis: bodies, load, rotation, contact"
        drawing = rig_svg(case, words).encode()
        rig.append(Picture("The rig", drawing, "image/svg+xml", alt))
    rows = wear if case is None else [*_bodies(case), *wear, *_test(case)]
    if rows:
        blocks.append(Table("The case in words", ("what", "how"), rows))
    blocks.append(Source("Case file, as run", text))
    for body, source in result.user_laws.items():
        blocks.append(Source(f"Law of {body}, a file of the user's", source))
    return rig, blocks


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
        f"Poisson's ratio {ring.poisson:g}", GRIPS[ring.grip], f"contact face: {face}",
    ]  # fmt: skip
    if ring.density is not None:
        words.append(f"density {ring.density:g} g/mm\N{SUPERSCRIPT THREE}")
    return "; ".join(words)


def _test(case: Case) -> list[tuple[str, str]]:
    omega, (inner, outer) = case.load.omega, case.contact
    speed = turning(case)
    if isinstance(omega, float):
        speed += f", {0.5 * omega * (inner + outer):.4g} mm/s at the mean radius"
    time = case.time
    end = time_words(time.end, time.end)
    steps = f"{time.steps} {time.scheme} steps of {time.step:g} s, {end} in all"
    if time.adaptive:
        steps = f"{end} in adaptive steps of a tolerance of {1e3 * time.tolerance:g} "
        steps += "\N{MICRO SIGN}m of wear"
    return [
        ("friction coefficient", quantity_text(case.friction)),
        ("load", pressing(case)), ("speed", speed),
        ("time", steps),
        ("contact line", f"{case.line.n} elements from {inner:g} to {outer:g} mm, geometry "
         f"{case.mesh.geometry}"),
    ]  # fmt: skip
