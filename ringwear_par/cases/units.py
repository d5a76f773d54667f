"""Numbers with units, such as "60 rpm", as numbers in the units of a case: mm, N, MPa, s, rad."""

import re
from collections.abc import Mapping
from functools import cache
from typing import Any

from ringwear_par.cases.values import RejectedError, UnitError
from ringwear_par.errors import legible

#: longest text of a unit, in characters: more is no unit, and slow to look at
_LONGEST = 40
#: characters of a column's name that are looked at for its unit, the last ones
_TAIL = 2 * _LONGEST
#: units to pint (year, barn, byte, tonne, powers) that tell columns apart in their names
_LABEL = re.compile(r"[abBt]|[A-Za-ln-z]\d+", re.ASCII)
#: read one way only, so that the time of long texts is linear in their length
_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_PLAIN = re.compile(_NUMBER, re.ASCII)
#: the number whole: "1e-7/MPa" is not 1 of the unit e-7/MPa
_WITH_UNIT = re.compile(rf"\s*((?>{_NUMBER}))\s*((?:[^\W\d_]|[%°µμ(]|1?\s*/).*)", re.ASCII)


#: as figures and pages write them: lengths of 1e-6 m, and powers
_MICROMETRES = re.compile(r"(?<![^\W\d_])[uµμ]m(?![^\W\d_])")
_POWERS = re.compile(r"(?<=[^\W\d_])\^?([23])(?![\w.])")
_RAISED = {"2": "\N{SUPERSCRIPT TWO}", "3": "\N{SUPERSCRIPT THREE}"}
#: units of specific wear rates: the usual one, and that of bearings
SPECIFIC, CUSTOMARY = "mm3/(N m)", "in3 min/(ft lbf h)"
#: units of mass that are typed for forces
_FORCES = {"kg": "kgf", "lb": "lbf", "lbs": "lbf", "g": "gf", "t": "tf", "oz": "ozf"}
#: a unit in a text, behind its number, with what it is divided by
_AMID = re.compile(r"(?<=\d )(?:[uµμ]m|mm\^?[23])(?:/\(?[^\W\d_]+)?(?![\w^]|\.\w)")


@cache
def _registry() -> Any:
    from pint import UnitRegistry  # slow to import, and only where units are read

    return UnitRegistry()


@cache
def factor(unit: str, base: str | None) -> float:
    """Return how much a unit is in another.

    Parameters
    ----------
    base : None: the unit of a case for whatever it is, of mm, N, s and rad, and g where no time is
        in it, as in densities.

    Raises
    ------
    RejectedError : pint does not know it, or it is one of something else; turns and angles are no
        plain numbers here, so that Hz is no unit of an angular speed.
    """
    text = _as_pint_has_it(unit)
    if not text or len(text) > _LONGEST:
        raise RejectedError
    registry = _registry()
    try:
        if base is None:
            return _in_case_units(registry.Quantity(1.0, registry.Unit(text)))
        quantity, base_quantity = (
            registry.Quantity(1.0, registry.Unit(name)) for name in (text, _as_pint_has_it(base))
        )
        if quantity.to_root_units().units != base_quantity.to_root_units().units:
            raise RejectedError
        return float(quantity.to(base_quantity.units).magnitude)
    except Exception as error:  # a syntax, a name, a dimension: pint has an exception for each
        raise RejectedError from error


def _in_case_units(quantity: Any) -> float:
    """Return a quantity of pint's in the unit that a case has for it."""
    if type(quantity)(0.0, quantity.units).to_base_units().magnitude:
        raise RejectedError  # degrees that count from elsewhere
    powers = quantity.dimensionality
    length, mass, time = (powers.get(f"[{name}]", 0) for name in ("length", "mass", "time"))
    # N is kg m/s2: with lengths in mm and times in s it goes with masses of 1000 kg
    of_mass = -3.0 if time else 3.0
    return float(quantity.to_base_units().magnitude * 10.0 ** (3.0 * length + of_mass * mass))


def _as_pint_has_it(unit: str) -> str:
    text = re.sub(r"([A-Za-zµμ])(-?\d)", r"\1^\2", unit.strip())  # mm3
    # Nm, which pint reads as 1/m
    return re.sub(r"\b([km]?)N\s*(m|mm|cm)\b(?![-^\d])", r"(\1N \2)", text)


def in_signs(unit: str) -> str:
    """Return a unit as figures and pages write it: ``µm`` for um, ``mm³`` for mm3 or mm^3."""
    return _POWERS.sub(lambda power: _RAISED[power[1]], _MICROMETRES.sub("\N{MICRO SIGN}m", unit))


def with_signs(text: str) -> str:
    """Return a text of the terminal as pages write it, its units behind numbers in signs."""
    return _AMID.sub(lambda unit: in_signs(unit[0]), text)


def unit_of_column(name: str, base: str) -> str | None:
    """Return the unit in a column's name, as in ``z_um``, ``z [um]`` or ``z / um``; or None."""
    ending, _ = _ending(name)
    try:
        factor(ending, base)
    except RejectedError:
        return None
    return ending


def named_unit(name: str, base: str) -> str | None:
    """Return the unit in a column's name; None where there is none.

    Raises
    ------
    RejectedError : it is a unit of something else, or there are brackets around what is no unit.
    """
    unit = unit_of_column(name, base)
    ending, bracketed = _ending(name)
    if unit is None and (_is_unit(ending) or bracketed):
        unit_text = legible(ending)
        raise UnitError(
            f"is in {unit_text} by its name"
            if _is_unit(ending)
            else f"ends with [{unit_text}], no unit"
        )
    return unit


def unit_of_anything(name: str) -> str | None:
    """Return the unit that a column's name ends with, of whatever it may be; or None."""
    ending, _ = _ending(name)
    return ending if _is_unit(ending) else None


def bare_name(name: str) -> str:
    """Return a column's name without the unit that it ends with."""
    unit = unit_of_anything(name)
    return name.strip() if unit is None else name[: name.rindex(unit)].rstrip(" _/[(")


def _ending(name: str) -> tuple[str, bool]:
    """Return the ending of a name that may be a unit, "" for none; whether in brackets."""
    tail = name.strip()[-_TAIL:]
    quantity, slash, unit = tail.partition("/")
    bare = re.sub(r"^[(\[](.*)[)\]]$", r"\1", unit.strip()).strip()
    apart = quantity.endswith(" ") or unit.startswith(" ")
    if slash and quantity.strip() and _is_unit(bare) and (apart or not _ends_with_unit(quantity)):
        return bare, False
    match = re.search(r"(_|\s*[\[(])\s*([^\s_\[\]()]+(?:\s[^\s_\[\]()]+)?)\s*[\])]?$", tail)
    return ("", False) if match is None else (match[2], match[1] != "_")


def _ends_with_unit(quantity: str) -> bool:
    """Tell whether the part of a name before a slash ends with a unit, as in ``v_mm/s``."""
    before, _, last = re.sub(r"[_\[(]", " ", quantity).rpartition(" ")
    return bool(before.strip()) and _is_unit(last)


def _is_unit(ending: str) -> bool:
    """Tell whether the ending of a name is a unit, of whatever it may be."""
    if not re.match(r"[^\W\d_]|[%°]", ending) or len(ending) > _LONGEST:
        return False
    if _LABEL.fullmatch(ending):
        return False
    try:
        _registry().Unit(_as_pint_has_it(ending))
    except Exception:  # pint has an exception for each reason
        return False
    return True


def seconds(text: str) -> float:
    """Return a time of a command line: in s, or with its unit ("2 h").

    Raises
    ------
    RejectedError : it is none.
    """
    return float(text) if is_plain(text) else number_in(text, "s")


def is_plain(text: str) -> bool:
    """Tell whether a text is a number without a unit."""
    return _PLAIN.fullmatch(text.strip()) is not None


def has_unit(value: Any) -> bool:
    """Tell whether a raw value is a text that begins with a number and goes on with a unit."""
    # 2e-6 is a number without one, not 2 of the unit e-6
    return (
        isinstance(value, str) and not is_plain(value) and _WITH_UNIT.fullmatch(value) is not None
    )


def number_and_unit(value: str) -> tuple[float, str]:
    """Return the number of a text with its unit, and that unit.

    Raises
    ------
    RejectedError : it has none.
    """
    match = _WITH_UNIT.fullmatch(value)
    if match is None:
        raise RejectedError
    unit = match[2].strip()
    return float(match[1]), f"1{unit}" if unit.startswith("/") else unit


def number_in(value: str, base: str | None) -> float:
    """Return a number with its unit in another one, see ``factor``.

    Raises
    ------
    RejectedError : it has no unit, or that of something else.
    """
    number, unit = number_and_unit(value)
    try:
        return float(f"{number * factor(unit, base):.15g}")  # "0.1 mm" is 0.1
    except RejectedError as error:
        raise UnitError(f"{legible(unit)} is no unit{_instead(unit, base)}") from error


def _instead(unit: str, base: str | None) -> str:
    """Return the rule for a unit that is wrong, and the unit that is likely meant."""
    if base is None:
        return " that is known"
    hint = ""
    if base == "rad/s":
        hint = "; turns are rpm or turn/s, and v in m/s at a radius r is omega = v/r"
    if base == "N" and unit in _FORCES:
        hint = f", but of a mass: did you mean {_FORCES[unit]}?"
    return f" of {base}{hint}"


def in_unit(value: Any, unit: str | None) -> Any:
    """Return a raw value, or lists and tables of some, with numbers in a unit that had their own.

    Parameters
    ----------
    unit : see ``factor``; none is converted where it is "", "-" or "1".

    Raises
    ------
    RejectedError : a unit is that of something else.
    """
    if isinstance(value, list | tuple):
        return [in_unit(entry, unit) for entry in value]
    if isinstance(value, Mapping):
        return {name: in_unit(entry, unit) for name, entry in value.items()}
    return number_in(value, unit) if has_unit(value) and unit not in ("", "-", "1") else value


def in_unit_where_right(value: Any, unit: str | None) -> Any:
    """Return ``in_unit``, or the raw value where a unit is wrong, which its reader refuses."""
    try:
        return in_unit(value, unit)
    except RejectedError:
        return value
