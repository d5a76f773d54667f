"""The keys of a case file: one list that reading, messages and ``info --schema`` follow."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

FIELDS = ("pressure", "gap", "wear_lower", "wear_upper")


class RejectedError(Exception):
    """A value that its key does not allow."""


Reader = Callable[[Any], Any]


@dataclass(frozen=True)
class Key:
    """One key of the case file.

    ``default`` is ... where the key must be given (for a wear law: once its table is there).
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


def _wear_keys(ring: str) -> list[Key]:
    return [
        Key(
            f"wear.{ring}.law", *_choice("threshold"), "-",
            f"rate of wear of {ring}: k mu max(0, p - p0) V; no table: does not wear",
            "threshold",
        ),
        Key(f"wear.{ring}.k", *_number(0.0, ends=True), "1/MPa", "wear coefficient"),
        Key(f"wear.{ring}.p0", *_number(0.0, ends=True), "MPa", "threshold pressure", 0.0),
    ]  # fmt: skip


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
    Key("load.force", *_number(0.0), "N", "axial force (control = force)", None),
    Key(
        "load.pressure", *_number(0.0), "MPa",
        "mean pressure over the nominal annulus, instead of load.force", None,
    ),
    Key(
        "load.displacement", *_number(0.0), "mm",
        "downward displacement of the upper ring's top (control = displacement)", None,
    ),
    Key("load.omega", *_number(0.0, ends=True), "rad/s", "angular speed of the upper ring"),
    Key(
        "time.scheme", *_choice("implicit", "explicit"), "-",
        "backward Euler inside the contact problem, or the paper's (6)", "implicit",
    ),
    Key("time.step", *_number(0.0), "s", "time step"),
    Key("time.steps", *_integer(1), "-", "number of time steps"),
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
    Key("output.fields", *_names(*FIELDS), "-", "fields stored along the contact line", FIELDS),
    Key(
        "output.profiles", *_choice("all", "last"), "-",
        "store these fields as often as the histories, or at the last step only", "all",
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
    return repr(value) if _is_number(value) else str(value)


def schema() -> str:
    """Return every key with its unit, default and meaning, as a table."""
    rows = [("key", "unit", "allowed", "default", "meaning")]
    for key in KEYS:
        if key.default is ...:
            default = "required" if not key.path.startswith("wear.") else "required with its table"
        else:
            default = "-" if key.default is None else toml_value(key.default)
        rows.append((key.path, key.unit, key.allowed, default, key.meaning))
    widths = [max(len(row[i]) for row in rows) for i in range(4)]
    return "\n".join(
        "  ".join([*(c.ljust(w) for c, w in zip(row, widths, strict=False)), row[4]])
        for row in rows
    )
