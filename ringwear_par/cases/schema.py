"""The keys of a case file: one list that reading, messages and ``info --schema`` follow."""

import itertools
import json
import math
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ringwear_par.schedules import Quantity, Table
from ringwear_par.wear.catalogue import LAWS
from ringwear_par.wear.parameters import Parameter, parameters_of

FIELDS = ("pressure", "gap", "wear_lower", "wear_upper")


class RejectedError(Exception):
    """A value that its key does not allow, perhaps with the reason."""


Reader = Callable[[Any], Any]


@dataclass(frozen=True)
class Key:
    """One key of the case file.

    ``default`` is ... where the key must be given.
    """

    path: str
    read: Reader
    allowed: str
    unit: str
    meaning: str
    default: Any = ...

    @property
    def rule(self) -> str:
        """What a message says of the values allowed, with their unit."""
        unit = "" if self.unit in ("-", "1") else f" ({self.unit})"
        return f"must be {self.allowed}{unit}"


def _is_number(value: Any) -> bool:
    """Tell whether a value is a number that a double can hold, NaN and infinities included."""
    whole = isinstance(value, int) and not isinstance(value, bool)
    return isinstance(value, float) or (whole and abs(value) < 10**300)


def _number(low: float, high: float = math.inf, *, ends: bool = False) -> tuple[Reader, str]:
    def read(value: Any) -> float:
        if not _is_number(value) or not math.isfinite(value):
            raise RejectedError
        if not (low < value < high or (ends and value in (low, high))):
            raise RejectedError
        return float(value)

    if high == math.inf:
        allowed = f"a finite number {'>=' if ends else '>'} {low:g}"
    elif ends:
        allowed = f"a number from {low:g} to {high:g}"
    else:
        allowed = f"a number > {low:g} and < {high:g}"
    return read, allowed


def _points(value: Any, number: Reader) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return abscissae, which must increase, and values of a list of pairs."""
    if not isinstance(value, list) or not value:
        raise RejectedError
    for pair in value:
        if not isinstance(pair, list) or len(pair) != 2:
            raise RejectedError
        if not _is_number(pair[0]) or not math.isfinite(pair[0]):
            raise RejectedError
    x = tuple(float(pair[0]) for pair in value)
    for before, after in itertools.pairwise(x):
        if after <= before:
            raise RejectedError(f"{after:g} after {before:g}: the first of each pair must increase")
    return x, tuple(number(pair[1]) for pair in value)


def _schedule(low: float, *, ends: bool = False) -> tuple[Reader, str]:
    """Return the reader of a number or a table in time, whose values may be ``low`` itself."""
    number, allowed = _number(low, ends=ends)
    entry, _ = _number(low, ends=True)

    def read(value: Any) -> Quantity:
        return Table(*_points(value, entry)) if isinstance(value, list) else float(number(value))

    zero = "" if ends else f" >= {low:g}"
    return read, f"{allowed}, or a table [[t, value{zero}], ...] in time, t in s and increasing"


def _quantity(low: float, *, ends: bool = False) -> tuple[Reader, str]:
    """Return the reader of a number, a table in time or a profile in r."""
    schedule, allowed = _schedule(low, ends=ends)
    number, _ = _number(low, ends=ends)

    def read(value: Any) -> Quantity:
        if isinstance(value, dict):
            if set(value) != {"r"}:
                raise RejectedError
            return Table(*_points(value["r"], number), "r")
        return schedule(value)

    return read, f"{allowed}, or a profile {{ r = [[r, value], ...] }}, r in mm and increasing"


def _parameters(value: Any) -> tuple[tuple[str, Quantity], ...]:
    if not isinstance(value, dict):
        raise RejectedError
    read, _ = _quantity(-math.inf)
    return tuple((name, read(v)) for name, v in value.items())


def _rates(value: Any) -> tuple[tuple[float, float], ...]:
    number, _ = _number(0.0, ends=True)
    x, y = _points(value, number)
    if len(x) < 2 or (x[0], y[0]) != (0.0, 0.0):
        raise RejectedError("it must have two points at least and begin with [0, 0]")
    for before, after in itertools.pairwise(y):
        if after < before:
            raise RejectedError(f"rate {after:g} after {before:g}: rates must not fall")
    return tuple(zip(x, y, strict=True))


def _times(value: Any) -> tuple[float, ...]:
    number, _ = _number(0.0)
    if not isinstance(value, list) or not value:
        raise RejectedError
    times = tuple(float(number(v)) for v in value)
    if any(after <= before for before, after in itertools.pairwise(times)):
        raise RejectedError
    return times


def _boundary(value: Any) -> str | tuple[float, ...]:
    if isinstance(value, str):
        if value not in ("none", "last", "all"):
            raise RejectedError
        return value
    number, _ = _number(0.0, ends=True)
    if not isinstance(value, list) or not value:
        raise RejectedError
    times = tuple(float(number(v)) for v in value)
    if any(after <= before for before, after in itertools.pairwise(times)):
        raise RejectedError
    return times


def _integer(low: int, high: int = 10**12) -> tuple[Reader, str]:
    def read(value: Any) -> int:
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise RejectedError
        return value

    return read, f"a whole number from {low} to {high:g}"


def _pair(low: float) -> tuple[Reader, str]:
    def read(value: Any) -> tuple[float, float]:
        if not isinstance(value, list) or len(value) != 2:
            raise RejectedError
        if not all(_is_number(v) and math.isfinite(v) and v >= low for v in value):
            raise RejectedError
        if not value[0] < value[1]:
            raise RejectedError
        return float(value[0]), float(value[1])

    return read, "two increasing numbers" + (f" >= {low:g}" if low > -math.inf else "")


def _is_finite(value: Any) -> bool:
    return _is_number(value) and math.isfinite(value)


def _chamfer(value: Any) -> tuple[float | None, float]:
    """Read [inner, outer], or one number for both (inner None: none on a solid disc)."""
    both = value if isinstance(value, list) else [value, value]
    if len(both) != 2 or not all(_is_finite(v) and v >= 0 for v in both):
        raise RejectedError
    return (float(both[0]) if both is value else None), float(both[1])


def _profile(value: Any) -> tuple[tuple[float, float], ...]:
    if not isinstance(value, list) or len(value) < 2:
        raise RejectedError
    for point in value:
        if not isinstance(point, list) or len(point) != 2 or not all(map(_is_finite, point)):
            raise RejectedError
    return tuple((float(r), float(z)) for r, z in value)


def _choice(*names: str) -> tuple[Reader, str]:
    def read(value: Any) -> str:
        if value not in names:
            raise RejectedError
        return str(value)

    return read, " or ".join(f'"{name}"' for name in names)


def _names(*names: str) -> tuple[Reader, str]:
    def read(value: Any) -> tuple[str, ...]:
        if not isinstance(value, list) or not all(v in names for v in value):
            raise RejectedError
        return tuple(name for name in names if name in value)

    return read, "a list of " + ", ".join(f'"{name}"' for name in names)


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise RejectedError
    return value


def _ring_keys(ring: str, name: str) -> list[Key]:
    return [
        Key(f"{ring}.r", *_pair(0.0), "mm", f"inner and outer radius of the {name}; 0: solid disc"),
        Key(f"{ring}.z", *_pair(-math.inf), "mm", f"bottom and top of the {name}"),
        Key(f"{ring}.young", *_number(0.0), "MPa", "Young's modulus"),
        Key(f"{ring}.poisson", *_number(-1.0, 0.5), "1", "Poisson's ratio"),
        Key(
            f"{ring}.profile", _profile, "at least 2 points [r, z] of finite numbers", "mm",
            f"contact face of the {ring} body as a polyline over increasing r", None,
        ),
    ]  # fmt: skip


def _parameter_reader(parameter: Parameter) -> tuple[Reader, str]:
    """Return what reads a law's parameter, and what is allowed."""
    if parameter.kind == "quantity":
        return _quantity(parameter.low, ends=parameter.ends)
    if parameter.kind == "number":
        return _number(parameter.low, parameter.high, ends=parameter.ends)
    if parameter.kind == "rates":
        return _rates, (
            "a table [[p V, rate], ...] from [0, 0], p V increasing and rates not falling"
        )
    if parameter.kind == "file":
        return _text, "the name of a Python file"
    return _parameters, "a table of numbers, tables in time or profiles in r"


def _wear_keys(ring: str) -> list[Key]:
    """Return the keys of a body's wear: ``law``, and what the laws declare."""
    table = f"wear.{ring}"
    formulas = "; ".join(f"{name}: {law.formula.rstrip(',')}" for name, law in LAWS.items())
    meaning = f"rate of wear of {ring}: {formulas}; no table [{table}]: does not wear"
    keys = [Key(f"{table}.law", *_choice(*LAWS), "-", meaning, None)]
    declared = [parameters_of(law) for law in LAWS.values()]
    for name in dict.fromkeys(itertools.chain(*declared)):
        users = {law: own[name] for law, own in zip(LAWS, declared, strict=True) if name in own}
        keys.append(_wear_key(f"{table}.{name}", users))
    return keys


def _wear_key(path: str, users: Mapping[str, Parameter]) -> Key:
    """Return the key of a parameter from the declarations of the laws that have it.

    Keys are read before their law is known: what is allowed must be the same for all of them.
    """
    first, *others = users.values()
    read, allowed = _parameter_reader(first)
    if any(_parameter_reader(other)[1] != allowed for other in others):
        raise ValueError(f"{path}: must allow the same in all laws that have it")
    meaning = first.meaning + "".join(
        f" ({law}: {other.meaning}, {other.unit})"
        for law, other in users.items()
        if (other.meaning, other.unit) != (first.meaning, first.unit)
    )
    default = None if first.default in (..., ()) else first.default
    return Key(path, read, allowed, first.unit, f"{meaning} (law = {' or '.join(users)})", default)


KEYS: tuple[Key, ...] = (
    Key("title", _text, "a text", "-", "shown in plots and summaries", ""),
    *_ring_keys("lower", "lower ring, its bottom held"),
    *_ring_keys("upper", "upper ring, which turns"),
    Key(
        "upper.grip", *_choice("clamped", "platen"), "-",
        "top of the upper ring: u_r = 0 (clamped) or sigma_rz = 0 (platen)", "clamped",
    ),
    Key(
        "upper.chamfer", _chamfer, "a number >= 0, or two of them: [inner, outer]", "mm",
        "45 degrees, on the contact corners of the upper ring; excludes upper.profile", None,
    ),
    Key("contact.friction", *_number(0.0, ends=True), "1", "Coulomb friction coefficient mu"),
    *_wear_keys("lower"),
    *_wear_keys("upper"),
    Key("load.control", *_choice("force", "displacement"), "-", "what is held constant", "force"),
    Key("load.force", *_schedule(0.0), "N", "axial force (control = force)", None),
    Key(
        "load.pressure", *_schedule(0.0), "MPa",
        "mean pressure over the nominal annulus, instead of load.force", None,
    ),
    Key(
        "load.displacement", *_schedule(0.0), "mm",
        "downward displacement of the upper ring's top (control = displacement)", None,
    ),
    Key(
        "load.omega", *_schedule(0.0, ends=True), "rad/s", "angular speed of the upper ring"
    ),
    Key(
        "time.scheme", *_choice("implicit", "explicit", "adaptive"), "-",
        "implicit: backward Euler inside the contact problem; explicit: the paper's (6); adaptive: "
        "second order, steps chosen by time.tolerance", "implicit",
    ),
    Key("time.step", *_number(0.0), "s", "time step (implicit, explicit)", None),
    Key("time.steps", *_integer(1), "-", "number of time steps (implicit, explicit)", None),
    Key(
        "time.end", *_number(0.0), "s",
        "end of an adaptive history; where it is absent, time.step x time.steps", None,
    ),
    Key(
        "time.tolerance", *_number(0.0), "mm",
        "largest estimated error of wear, of both bodies together, of one adaptive step", 2.5e-6,
    ),
    Key("mesh.contact_elements", *_integer(4), "-", "elements of the contact line", 64),
    Key(
        "mesh.grading", *_number(1.0, 6.0, ends=True), "1",
        "grading of the contact line towards its edges; 1 is uniform", 2.5,
    ),
    Key(
        "mesh.quadrature_tolerance", *_number(1e-10, 1e-2, ends=True), "1",
        "relative accuracy of the element integrals", 1e-7,
    ),
    Key(
        "mesh.contact", *_pair(0.0), "mm",
        "radii between which contact may arise; default: where the bodies face each other", None,
    ),
    Key(
        "mesh.geometry", *_choice("fixed", "updated"), "-",
        "updated: the elements follow the worn profile; fixed: it enters through the gap alone",
        "fixed",
    ),
    Key(
        "mesh.geometry_tolerance", *_number(0.0), "mm",
        "wear since the last assembly that asks for a new one (geometry = updated)", 0.005,
    ),
    Key("output.every", *_integer(1), "steps", "store every so many steps, and the last", 1),
    Key(
        "output.times", _times, "a list of increasing numbers > 0", "s",
        "store at these times, the start and the end instead", None,
    ),
    Key("output.fields", *_names(*FIELDS), "-", "fields stored along the contact line", FIELDS),
    Key(
        "output.profiles", *_choice("all", "last"), "-",
        "store these fields as often as the histories, or at the last step only", "all",
    ),
    Key(
        "output.boundary", _boundary, '"none", "last", "all" or a list of increasing times (s)',
        "-",
        "stored steps at which displacement and traction of both whole boundaries are stored; "
        "times: the first stored step from each on", "none",
    ),
)  # fmt: skip


UNITS = {key.path: key.unit for key in KEYS}
BY_PATH = {key.path: key for key in KEYS}
TABLES = {key.path[:cut] for key in KEYS for cut, c in enumerate(key.path) if c == "."}


def toml_value(value: Any) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)  # TOML's escapes are JSON's
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(v) for v in value) + "]"
    if isinstance(value, dict):
        items = ", ".join(f"{json.dumps(k)} = {toml_value(v)}" for k, v in value.items())
        return "{ " + items + " }"
    return repr(value) if _is_number(value) else str(value)


def schema() -> str:
    """Return every key with its unit, default and meaning, and what is allowed below each."""
    rows = [("key", "unit", "default", "meaning, and what is allowed")]
    for key in KEYS:
        default = "required" if key.default is ... else "-"
        if key.default is not ... and key.default is not None:
            default = toml_value(key.default)
        lines = textwrap.wrap(key.meaning, 90) + textwrap.wrap(key.allowed, 86)
        first = len(textwrap.wrap(key.meaning, 90))
        lines[first:] = [f"    {line}" for line in lines[first:]]
        if len(default) > 20:  # a row of its own
            lines.insert(1, f"    default: {default}")
            default = "below"
        rows.append((key.path, key.unit, default, lines[0]))
        rows += [("", "", "", line) for line in lines[1:]]
    widths = [max(len(row[i]) for row in rows) for i in range(3)]
    return "\n".join(
        "  ".join([*(c.ljust(w) for c, w in zip(row, widths, strict=False)), row[3]]).rstrip()
        for row in rows
    )
