"""The keys of a case file: one list that reading, messages and ``info --schema`` follow."""

import itertools
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

from ringwear_par.cases.faces import SHAPE_UNITS
from ringwear_par.cases.tables import Key
from ringwear_par.cases.units import in_signs
from ringwear_par.cases.values import (
    Values,
    chamfer,
    choice,
    counts,
    number,
    pair,
    parameters,
    places,
    profile,
    quantity,
    rates,
    schedule,
    some_of,
    tables,
    text,
    times,
    which_times,
    whole,
)
from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.wear.laws import LAWS, Kind, Parameter


class Scheme(NamedTuple):
    """A value of ``time.scheme``, whose steps ``history/schemes.py`` makes."""

    meaning: str
    #: whether lengths of steps are chosen by a tolerance, to ``time.end``
    adaptive: bool = False
    #: whether steps are stable only up to a length
    explicit: bool = False


SCHEMES = {
    "implicit": Scheme("backward Euler inside the contact problem"),
    "explicit": Scheme("forward Euler, equation (6) of the paper", explicit=True),
    "adaptive": Scheme("second order, steps chosen by time.tolerance", adaptive=True),
}
_FIXED = ", ".join(name for name, scheme in SCHEMES.items() if not scheme.adaptive)


class StopCriterion(NamedTuple):
    """A key of [stop]: a quantity that grows to a limit, at which a history ends.

    ``history/loop.py`` has the quantities.
    """

    unit: str
    meaning: str


STOP_CRITERIA = {
    "penetration": StopCriterion("mm", "penetration depth"),
    "wear_lower": StopCriterion("mm", "largest depth worn off lower"),
    "wear_upper": StopCriterion("mm", "largest depth worn off upper"),
    "energy": StopCriterion("N mm", "energy dissipated by friction"),
}

#: most layers of a body, and most points of a grid along r or z
MOST_LAYERS, MOST_ON_A_SIDE = 1000, 10_000

FIELDS = ("pressure", "gap", "wear_lower", "wear_upper")


def _ring_keys(ring: str, name: str) -> list[Key]:
    return [
        Key(f"{ring}.r", *pair(0.0), "mm", f"inner and outer radius of the {name}; 0: solid disc"),
        Key(f"{ring}.z", *pair(-math.inf), "mm", f"bottom and top of the {name}"),
        Key(f"{ring}.young", *number(0.0), "MPa", "Young's modulus"),
        Key(f"{ring}.poisson", *number(-1.0, 0.5), "1", "Poisson's ratio"),
        Key(
            f"{ring}.profile", *profile(), "mm",
            f"contact face of the {ring} body as a polyline over increasing r, or {{ crown = R }} "
            "(round over its width), { sphere = R } (centre on the axis), { cone = angle } "
            "(degrees, > 0: recedes outwards), { fillet = R or [inner, outer] }, { file = name } "
            "of a table of radii and heights",
            None,
        ),
        Key(
            f"{ring}.density", *number(0.0), "g/mm^3",
            "density of the body under its layers (each layer has its own), for the lost mass in "
            "summaries and fits", None,
        ),
        Key(
            f"{ring}.layers",
            *tables(
                "{ thickness, young, poisson, density, wear }, from the contact face inwards, or "
                f"[[{ring}.layers]] for each of them",
                MOST_LAYERS,
            ),
            "-",
            f"coatings and bonded layers of the {ring} body. Each has thickness (mm), young (MPa) "
            "and poisson, and may have density (g/mm^3, for the lost mass) and wear, a table with "
            f"its wear law and parameters (default: those of [wear.{ring}]). Studies and --set "
            f"name its entries {ring}.layers[0].thickness, {ring}.layers[0].wear.k and so on",
            (),
        ),
    ]  # fmt: skip


def _values(parameter: Parameter) -> Values:
    """Return the values that a law's parameter may have."""
    if parameter.kind == "quantity":
        return quantity(parameter.low, ends=parameter.ends)
    if parameter.kind == "number":
        return number(parameter.low, parameter.high, ends=parameter.ends)
    if parameter.kind == "rates":
        return rates()
    return text("the name of a Python file") if parameter.kind == "file" else parameters()


def _wear_keys(table: str, owner: str, absent: str, laws: Mapping[str, Kind]) -> list[Key]:
    """Return the keys of a table of wear: ``law``, and what the laws declare.

    Parameters
    ----------
    of : what wears.
    absent : what it does without the table.
    laws : that it may wear by.
    """
    formulas = "; ".join(f"{name}: {law.formula}" for name, law in laws.items())
    meaning = f"rate of wear of {owner}: {formulas}; no table {absent}"
    keys = [Key(f"{table}.law", *choice(*laws), "-", meaning, None)]
    declared = [law.parameters for law in laws.values()]
    for name in dict.fromkeys(itertools.chain(*declared)):
        users = {
            law: parameters[name]
            for law, parameters in zip(laws, declared, strict=True)
            if name in parameters
        }
        keys.append(_wear_key(f"{table}.{name}", users))
    return keys


def _wear_key(path: str, users: Mapping[str, Parameter]) -> Key:
    """Return the key of a parameter from the declarations of the laws that have it.

    Keys are read before their law is known: what is allowed must be the same for all of them.
    """
    first, *rest = users.values()
    values = _values(first)
    if any(_values(variant).allowed != values.allowed for variant in rest):
        raise ValueError(f"{path}: must allow the same in all laws that have it")
    meaning = first.meaning + "".join(
        f" ({law}: {variant.meaning}, {variant.unit})"
        for law, variant in users.items()
        if (variant.meaning, variant.unit) != (first.meaning, first.unit)
    )
    default = None if first.default in (..., ()) else first.default
    return Key(path, *values, first.unit, f"{meaning} (law = {' or '.join(users)})", default)


KEYS: tuple[Key, ...] = (
    Key("title", *text(), "-", "shown in summaries and reports", ""),
    *_ring_keys("lower", "lower body, held at its bottom"),
    *_ring_keys("upper", "upper body, which turns"),
    Key(
        "upper.grip", *choice("clamped", "platen"), "-",
        "how the top of the upper body is held: clamped, u_r = 0, or on a platen, free to widen, "
        "sigma_rz = 0", "clamped",
    ),
    Key(
        "upper.chamfer", *chamfer(), "mm",
        "width of chamfers of 45 degrees on the contact corners of the upper body; not together "
        "with upper.profile", None,
    ),
    Key("contact.friction", *schedule(0.0, ends=True), "1", "Coulomb friction coefficient mu"),
    *(
        key
        for body in ("lower", "upper")
        for key in _wear_keys(f"wear.{body}", body, f"[wear.{body}]: does not wear", LAWS)
    ),
    Key(
        "load.control", *choice("force", "displacement"), "-",
        "prescribed quantity: the axial force, or the displacement of the upper body's top",
        "force",
    ),
    Key("load.force", *schedule(0.0), "N", "axial force (control = force)", None),
    Key(
        "load.pressure", *schedule(0.0), "MPa",
        "mean pressure over the nominal annulus, instead of load.force", None,
    ),
    Key(
        "load.displacement", *schedule(0.0), "mm",
        "downward displacement of the upper body's top (control = displacement)", None,
    ),
    Key(
        "load.omega", *schedule(0.0, ends=True), "rad/s", "angular speed of the upper body"
    ),
    Key(
        "time.scheme", *choice(*SCHEMES), "-",
        "; ".join(f"{name}: {scheme.meaning}" for name, scheme in SCHEMES.items()), "implicit",
    ),
    Key("time.step", *number(0.0), "s", f"time step ({_FIXED})", None),
    Key("time.steps", *whole(1), "-", f"number of time steps ({_FIXED})", None),
    Key(
        "time.end", *number(0.0), "s",
        "end of an adaptive history; default: time.step x time.steps", None,
    ),
    Key(
        "time.tolerance", *number(0.0), "mm",
        "largest error that adaptive steps are to make in the wear depth of both bodies together, "
        "over the whole history; without the errors of the mesh", 1e-5,
    ),
    *(
        Key(
            f"stop.{name}", *number(0.0), criterion.unit,
            f"{criterion.meaning} at which the history ends, after the step that reaches it, if it "
            "is before the end of time; not in fits, predictions and functions", None,
        )
        for name, criterion in STOP_CRITERIA.items()
    ),
    Key("mesh.contact_elements", *whole(4), "-", "number of contact elements",
        Mesh.contact_elements),
    Key(
        "mesh.grading", *number(1.0, 6.0, ends=True), "1",
        "grading of the contact elements towards the edges of contact: larger is finer there; 1: "
        "equal elements", Mesh.grading,
    ),
    Key(
        "mesh.quadrature_tolerance", *number(1e-10, 1e-2, ends=True), "1",
        "relative error of the integrals over boundary elements", Mesh.quadrature_tolerance,
    ),
    Key(
        "mesh.contact", *pair(0.0), "mm",
        "inner and outer radius between which contact is possible; default: wherever the bodies "
        "face each other", None,
    ),
    Key(
        "mesh.geometry", *choice("fixed", "updated"), "-",
        "fixed: elements stay on the unworn bodies, and wear changes the gap alone; updated: "
        "elements follow the worn profile", Mesh.geometry,
    ),
    Key(
        "mesh.geometry_tolerance", *number(0.0), "mm",
        "wear depth after which the elements are moved and assembled again (geometry = updated)",
        Mesh.geometry_tolerance,
    ),
    Key("output.every", *whole(1), "steps", "store every so many steps, and the last one", 1),
    Key(
        "output.times", *times(), "s",
        "times at which steps end and are stored, besides the start and the end; instead of "
        "output.every",
        None,
    ),
    Key("output.fields", *some_of(*FIELDS), "-", "fields stored along the contact line", FIELDS),
    Key(
        "output.profiles", *choice("all", "last"), "-",
        "steps at which output.fields are stored: all stored steps, or the last only", "all",
    ),
    Key(
        "output.boundary", *which_times("none", "last", "all"), "s",
        "steps at which displacement and traction on the whole boundaries of both bodies are "
        "stored; a time stands for the first stored step at or after it", "none",
    ),
    Key(
        "stress.points", *places("above", "below"), "mm",
        "points at which stress is stored (without a table [stress], none is computed). On the "
        "contact faces the side names the body: above is upper, below is lower", None,
    ),
    Key(
        "stress.grid.body", *choice("lower", "upper", "both"), "-",
        "body in which stress is stored on a grid; grid points outside it have no stress", "both",
    ),
    Key("stress.grid.r", *pair(0.0), "mm", "first and last radius of the grid", None),
    Key("stress.grid.z", *pair(-math.inf), "mm", "first and last height of the grid", None),
    Key(
        "stress.grid.n", *counts(2, MOST_ON_A_SIDE), "-",
        "number of radii and of heights of the grid", None,
    ),
    Key(
        "stress.times", *which_times("last", "all"), "s",
        "steps at which stress is stored; a time stands for the first stored step at or after it",
        "last",
    ),
    Key(
        "stress.exclude", *number(0.0, ends=True), "mm",
        "distance from edges of contact within which the search for the largest von Mises stress "
        "leaves points out: at unworn edges stress is infinite", 0.1,
    ),
)  # fmt: skip


#: the laws that layers may wear by: local ones, and no files
LAYER_LAWS = {name: law for name, law in LAWS.items() if name not in ("non-local", "user")}
#: the entries of a layer
LAYER_KEYS: tuple[Key, ...] = (
    Key("thickness", *number(0.0), "mm", "thickness of the layer, along the axis"),
    Key("young", *number(0.0), "MPa", "Young's modulus of the layer"),
    Key("poisson", *number(-1.0, 0.5), "1", "Poisson's ratio of the layer"),
    Key("density", *number(0.0), "g/mm^3", "density of the layer, for the lost mass", None),
    *_wear_keys("wear", "the layer", "wear: wears as the body", LAYER_LAWS),
)
_LAYER_ENTRIES = {key.path: key for key in LAYER_KEYS}
_PAIR = re.compile(r"(.+)\[([01])\]")
_LAYER = re.compile(r"((?:lower|upper)\.layers)(\[[0-9]{1,3}\])\.(.+)")

#: what figures and pages call quantities, with their symbols, by the last part of their keys;
#: others are called as their meaning begins
QUANTITIES = {
    "r": "radii", "r[0]": "inner radius", "r[1]": "outer radius", "z": "heights",
    "z[0]": "bottom", "z[1]": "top", "young": "Young's modulus E",
    "poisson": "Poisson's ratio \N{GREEK SMALL LETTER NU}", "profile": "contact face",
    "chamfer": "chamfer", "chamfer[0]": "inner chamfer", "chamfer[1]": "outer chamfer",
    "thickness": "thickness", "density": "density", "layers": "layers", "grip": "grip",
    "friction": "friction coefficient \N{GREEK SMALL LETTER MU}", "law": "wear law",
    "k": "wear coefficient k", "p0": "threshold pressure p0", "m": "pressure exponent m",
    "n": "speed exponent n", "k_start": "initial wear coefficient k_start",
    "depth": "running-in depth", "distance": "running-in distance",
    "length": "averaging length", "table": "wear rates", "control": "control",
    "force": "axial force F", "pressure": "mean pressure", "displacement": "displacement",
    "omega": "angular speed \N{GREEK SMALL LETTER OMEGA}", "scheme": "time scheme",
    "step": "time step", "steps": "number of steps", "end": "duration",
    "tolerance": "tolerance of time steps", "contact_elements": "number of contact elements",
    "grading": "grading of the mesh", "geometry": "geometry",
}  # fmt: skip
_OF_BODY = re.compile(r"(?:wear\.)?(lower|upper)\.(?:layers\[(\d+)\])?")

UNITS = {key.path: key.unit for key in KEYS}
BY_PATH = {key.path: key for key in KEYS}
TABLES = {key.path[:cut] for key in KEYS for cut, c in enumerate(key.path) if c == "."}


def pair_entry(name: str) -> tuple[str, int] | None:
    """Return key and which of its two numbers: "upper.r" and 1 of "upper.r[1]"; None of others."""
    match = _PAIR.fullmatch(name)
    return None if match is None else (match[1], int(match[2]))


def layer_entry(name: str) -> tuple[str, str, str] | None:
    """Return key, which layer and which of its entries: "lower.layers", "[0]" and "wear.k".

    None where a name is not that of an entry of a layer.
    """
    match = _LAYER.fullmatch(name)
    return None if match is None else (match[1], match[2], match[3])


@cache
def keys_of_layer(table: str) -> list[Key]:
    """Return the keys of a layer, "lower.layers[0]", under their whole names."""
    return [replace(key, path=f"{table}.{key.path}") for key in LAYER_KEYS]


def key_of(name: str) -> Key | None:
    """Return the key of this name, or that of an entry of a layer; None where there is none."""
    entry = layer_entry(name)
    return BY_PATH.get(name) if entry is None else _LAYER_ENTRIES.get(entry[2])


def quantity_name(name: str) -> str:
    """Return the name of a key in figures and pages, such as "wear coefficient k, lower"."""
    last, body, key = name.rpartition(".")[2], _OF_BODY.match(name), key_of(name)
    words = last.replace("_", " ") if key is None else re.split("[,;:(]", key.meaning)[0].strip()
    words = QUANTITIES.get(last, words) if ".parameters." not in name else f"parameter {last}"
    if body is None:
        return words
    return f"{words}, {body[1]}" if body[2] is None else f"{words}, layer {body[2]} of {body[1]}"


def quantity_label(name: str, unit: str) -> str:
    """Return the name of a key in figures and pages, with a unit, "" for none."""
    return f"{quantity_name(name)} ({in_signs(unit)})" if unit else quantity_name(name)


def law_keys(table: str, law: Any) -> set[str]:
    """Return the keys of a body's wear table, "wear.lower", under a law; none if it is no law."""
    if not (isinstance(law, str) and law in LAWS):
        return set()
    return {f"{table}.law", *(f"{table}.{name}" for name in LAWS[law].parameters)}


def base_unit(name: str) -> str | None:
    """Return the unit to which numbers of a key are converted, see ``units.factor``.

    None of a parameter of a user's law, whose unit is not declared.
    """
    return None if BY_PATH.get(name) is None and ".parameters." in name else unit_of(name)


def unit_of(name: str) -> str:
    """Return the unit of a key, or of an entry of one, as studies name them; "" for none."""
    if layer_entry(name) is not None:
        key = key_of(name)
        return "" if key is None or key.unit in ("-", "1") else key.unit
    path = name.partition("[")[0]
    key, entry = BY_PATH.get(path), ""
    if key is None:
        table, _, entry = path.rpartition(".")
        key = BY_PATH.get(table)
    if key is None or key.unit in ("-", "1"):
        return ""
    if key.path.endswith(".profile"):  # of which each shape has its own
        return SHAPE_UNITS.get(entry, "")
    return key.unit


def unit_under(name: str, laws: Callable[[str], Iterable[Any]]) -> str:
    """Return the unit of a key as ``unit_of``, of a law's parameter the one that laws give it.

    Parameters
    ----------
    laws : returns those that a key of a law, such as ``wear.lower.law``, has; where their units
        differ there is none.
    """
    table, _, parameter = name.rpartition(".")
    key = f"{table}.law"
    if key_of(key) is None:
        return unit_of(name)
    declared = [LAWS[law].parameters for law in laws(key) if isinstance(law, str) and law in LAWS]
    units = {of_law[parameter].unit for of_law in declared if parameter in of_law}
    unit = units.pop() if len(units) == 1 else "" if units else unit_of(name)
    return "" if unit in ("-", "1") else unit
