"""What the keys of a case file may hold: how values are read, and what messages say of them."""

import difflib
import itertools
import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.cases.faces import SHAPE_UNITS, Shape
from ringwear_par.errors import Code, legible
from ringwear_par.schedules import Quantity, Table

#: a schedule is a number or a table in time, a quantity these or a profile along the radius
Kind = Literal[
    "number", "whole", "schedule", "quantity", "pair", "chamfer", "points", "times", "choice",
    "names", "text", "parameters", "layers", "places", "counts", "any",
]  # fmt: skip
Reader = Callable[[Any], Any]
#: characters of a word that are compared with the allowed ones
_LONGEST = 40
#: magnitudes of all numbers but 0: far beyond any, and products of many of them are finite
LEAST, MOST = 1e-60, 1e30


class RejectedError(Exception):
    """A value that its key does not allow, perhaps with the reason."""

    code: Code = "not_allowed"


class UnitError(RejectedError):
    """A unit that is that of something else, or none."""

    code: Code = "unit"


class Interval(NamedTuple):
    """The numbers between two, perhaps themselves included, of the magnitudes allowed."""

    low: float
    high: float = math.inf
    ends: bool = False

    def holds(self, numbers: FloatArray) -> BoolArray:
        """Return which numbers are of these."""
        inside = (self.low < numbers) & (numbers < self.high)
        if self.ends:
            inside |= (numbers == self.low) | (numbers == self.high)
        size = np.abs(numbers)
        return inside & (size <= MOST) & ((size >= LEAST) | (size == 0.0))


class Values(NamedTuple):
    """The values of a key."""

    #: what they are
    kind: Kind
    #: takes a raw value, as TOML gives it, and returns what a case holds
    read: Reader
    #: what messages say after "must be"
    allowed: str
    #: those that ``read`` takes and returns as floats; None where it takes no such
    numbers: Interval | None = None


def is_number(value: Any) -> bool:
    """Tell whether a value is a number that a double can hold, NaN and infinities included."""
    whole = isinstance(value, int) and not isinstance(value, bool)
    return isinstance(value, float) or (whole and abs(value) < 10**300)


def is_finite(value: Any) -> bool:
    """Tell whether a value is a finite number.

    Raises
    ------
    RejectedError : it is, but of a magnitude that nothing can be computed with.
    """
    if not (is_number(value) and math.isfinite(value)):
        return False
    if fault := magnitude_fault(value):
        raise RejectedError(fault)
    return True


def magnitude_fault(value: float) -> str:
    """Return the fault of the magnitude of a number, "" for none."""
    if value == 0 or LEAST <= abs(value) <= MOST:
        return ""
    return f"numbers other than 0 must be from {LEAST:g} to {MOST:g} in magnitude"


def number(low: float, high: float = math.inf, *, ends: bool = False) -> Values:
    """Return the numbers between two, perhaps themselves included."""

    def read(value: Any) -> float:
        read_number = _finite(value)
        if not (low < value < high or (ends and value in (low, high))):
            raise RejectedError
        return read_number

    if (low, high) == (-math.inf, math.inf):
        allowed = "a finite number"
    elif high == math.inf:
        allowed = f"a finite number {'>=' if ends else '>'} {low:g}"
    elif ends:
        allowed = f"a number from {low:g} to {high:g}"
    else:
        allowed = f"a number > {low:g} and < {high:g}"
    return Values("number", read, allowed, Interval(low, high, ends))


def whole(low: int, high: int = 10**12) -> Values:
    """Return the whole numbers from one to another."""

    def read(value: Any) -> int:
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise RejectedError
        return value

    return Values("whole", read, f"a whole number from {low} to {high:g}")


def _finite(value: Any) -> float:
    if not is_finite(value):
        raise RejectedError
    return float(value)


def entries(value: Any, read: Reader, least: int = 1, most: float = math.inf) -> tuple[Any, ...]:
    """Return the entries of a list of so many, each as it is read."""
    if not isinstance(value, list) or not least <= len(value) <= most:
        raise RejectedError
    return tuple(read(entry) for entry in value)


def _points(value: Any, read: Reader) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return abscissae, which must increase, and values of a list of pairs."""
    pairs = entries(value, lambda pair: entries(pair, lambda entry: entry, 2, 2))
    x = tuple(_finite(pair[0]) for pair in pairs)
    for before, after in itertools.pairwise(x):
        if after <= before:
            raise RejectedError(f"{after:g} after {before:g}: the first of each pair must increase")
    return x, tuple(read(pair[1]) for pair in pairs)


def schedule(low: float, *, ends: bool = False) -> Values:
    """Return numbers and tables in time, whose values may be ``low`` itself."""
    constant, entry = number(low, ends=ends), number(low, ends=True)

    def read(value: Any) -> Quantity:
        if isinstance(value, list):
            return Table(*_points(value, entry.read))
        return float(constant.read(value))

    zero = "" if ends else f" >= {low:g}"
    table = f"or a table [[t, value{zero}], ...] in time, t in s and increasing"
    return Values("schedule", read, f"{constant.allowed}, {table}", constant.numbers)


def quantity(low: float, *, ends: bool = False) -> Values:
    """Return numbers, tables in time and profiles along the radius."""
    in_time, constant = schedule(low, ends=ends), number(low, ends=ends)

    def read(value: Any) -> Quantity:
        if isinstance(value, dict):
            if set(value) != {"r"}:
                raise RejectedError
            return Table(*_points(value["r"], constant.read), "r")
        return in_time.read(value)

    table = "or a profile { r = [[r, value], ...] }, r in mm and increasing"
    return Values("quantity", read, f"{in_time.allowed}, {table}", constant.numbers)


def parameters() -> Values:
    """Return tables of named quantities."""

    def read(value: Any) -> tuple[tuple[str, Quantity], ...]:
        if not isinstance(value, dict):
            raise RejectedError
        for name in value:
            if not name.isidentifier():  # results are stored under it, separated by blanks
                raise RejectedError(
                    f'"{legible(name)}": names must be of letters, digits and _, and begin with '
                    "no digit"
                )
        return tuple((name, entry.read(v)) for name, v in value.items())

    entry = quantity(-math.inf)
    allowed = "a table of numbers, tables in time or profiles in r"
    return Values("parameters", read, allowed)


def rates() -> Values:
    """Return tables of a rate that begin with [0, 0] and do not fall."""

    def read(value: Any) -> tuple[tuple[float, float], ...]:
        x, y = _points(value, number(0.0, ends=True).read)
        if len(x) < 2 or (x[0], y[0]) != (0.0, 0.0):
            raise RejectedError("it must have two points at least and begin with [0, 0]")
        for before, after in itertools.pairwise(y):
            if after < before:
                raise RejectedError(f"rate {after:g} after {before:g}: rates must not fall")
        return tuple(zip(x, y, strict=True))

    allowed = "a table [[p V, rate], ...] from [0, 0], p V increasing and rates not falling"
    return Values("points", read, allowed)


def increasing(
    value: Any, read: Reader, least: int = 1, most: float = math.inf
) -> tuple[float, ...]:
    """Return the numbers of a list of so many, which must increase, each as it is read."""
    numbers = entries(value, read, least, most)
    if any(after <= before for before, after in itertools.pairwise(numbers)):
        raise RejectedError
    return numbers


def times() -> Values:
    """Return lists of increasing times, s, after the start."""
    return Values(
        "times",
        lambda value: increasing(value, number(0.0).read),
        "a list of increasing numbers > 0",
    )


def of_type(kind: type) -> Reader:
    """Return the reader of what is of a type."""

    def read(value: Any) -> Any:
        if not isinstance(value, kind):
            raise RejectedError
        return value

    return read


def which_times(*names: str) -> Values:
    """Return lists of increasing times, s, and names for some of them."""
    one_of = choice(*names).read

    def read(value: Any) -> str | tuple[float, ...]:
        if isinstance(value, str):
            return one_of(value)
        return increasing(value, number(0.0, ends=True).read)

    quoted = ", ".join(f'"{name}"' for name in names)
    return Values("times", read, f"{quoted} or a list of increasing times")


def pair(low: float) -> Values:
    """Return two increasing numbers."""
    entry = number(low, ends=True).read
    allowed = "two increasing numbers" + (f" >= {low:g}" if low > -math.inf else "")
    return Values("pair", lambda value: increasing(value, entry, 2, 2), allowed)


def chamfer() -> Values:
    """Return [inner, outer], or one number for both (inner None: none on a solid disc)."""

    def read(value: Any) -> tuple[float | None, float]:
        if not isinstance(value, list):
            return None, width(value)
        inner, outer = entries(value, width, 2, 2)
        return inner, outer

    width = number(0.0, ends=True).read

    return Values("chamfer", read, "a number >= 0, or two of them: [inner, outer]")


def _shape(value: dict[str, Any]) -> Shape:
    """Return the shape of a contact face that a table names."""
    if len(value) != 1 or not value.keys() <= SHAPE_UNITS.keys():
        raise RejectedError
    ((name, raw),) = value.items()
    if name == "trace":
        x, z = _points(raw, number(-math.inf).read)
        if len(x) < 2:
            raise RejectedError("a trace needs 2 points at least")
        return Shape(name, tuple(itertools.chain(*zip(x, z, strict=True))))
    values = {"fillet": chamfer(), "cone": number(-45.0, 45.0)}.get(name, number(0.0))
    try:
        size = values.read(raw)
    except RejectedError as error:
        raise RejectedError(f"{name} must be {values.allowed}") from error
    sizes = size if isinstance(size, tuple) else (size,)
    return Shape(name, tuple(size for size in sizes if size is not None))


def profile() -> Values:
    """Return polylines and shapes with names."""

    def read(value: Any) -> tuple[tuple[float, float], ...] | Shape:
        if isinstance(value, dict):
            return _shape(value)
        return entries(value, lambda point: entries(point, _finite, 2, 2), 2)

    shapes = "{ crown, sphere, cone, fillet or file }"
    return Values("points", read, f"at least 2 points [r, z] of finite numbers or {shapes}")


def tables(content: str, most: int) -> Values:
    """Return lists of tables whose entries are keys themselves, read one by one elsewhere.

    Parameters
    ----------
    content : keys of the tables, in words.
    most : largest number of tables.
    """

    def read(value: Any) -> tuple[dict[str, Any], ...]:
        read_tables = entries(value, of_type(dict), 0)
        if len(value) > most:
            raise RejectedError(f"there are {len(value)} of them")
        return read_tables

    return Values("layers", read, f"a list of at most {most} tables {content}")


def places(*sides: str) -> Values:
    """Return lists of points, some with a side."""

    def read(point: Any) -> tuple[float, float, str]:
        r, z, *side = entries(point, lambda entry: entry, 2, 3)
        if not all(s in sides for s in side):
            raise RejectedError
        return _finite(r), _finite(z), str(*side)

    quoted = " or ".join(f'"{side}"' for side in sides)
    allowed = f"a list of points [r, z], or [r, z, side] with the side {quoted}"
    return Values("places", lambda value: entries(value, read), allowed)


def counts(low: int, high: int) -> Values:
    """Return pairs of whole numbers from one to another."""
    count = whole(low, high).read
    allowed = f"two whole numbers from {low} to {high:g}"
    return Values("counts", lambda value: entries(value, count, 2, 2), allowed)


def choice(*names: str) -> Values:
    """Return one of some names."""

    def read(value: Any) -> str:
        if value not in names:
            word = value if isinstance(value, str) else ""
            near = difflib.get_close_matches(word[:_LONGEST].lower(), names, n=1)
            raise RejectedError(f'did you mean "{near[0]}"?' if near else "")
        return str(value)

    return Values("choice", read, " or ".join(f'"{name}"' for name in names))


def one_of(*names: str) -> Values:
    """Return one of many names."""
    return choice(*names)._replace(allowed=f"one of {', '.join(names)}")


def anything(allowed: str) -> Values:
    """Return values that are read elsewhere, by their rules."""
    return Values("any", lambda value: value, allowed)


def some_of(*names: str) -> Values:
    """Return lists of some names, in the order of these."""

    def read(value: Any) -> tuple[str, ...]:
        chosen = entries(value, choice(*names).read, 0)
        return tuple(name for name in names if name in chosen)

    return Values("names", read, "a list of " + ", ".join(f'"{name}"' for name in names))


def texts(allowed: str) -> Values:
    """Return lists of texts."""
    return Values("names", lambda value: entries(value, of_type(str), 0), allowed)


def text(allowed: str = "a text") -> Values:
    """Return texts that can be written to a file."""

    def read(value: Any) -> str:
        if not isinstance(value, str):
            raise RejectedError
        if any(c == "\0" or "\ud800" <= c <= "\udfff" for c in value):
            raise RejectedError("no zero bytes or halves of characters")
        return value

    return Values("text", read, allowed)
