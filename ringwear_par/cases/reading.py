"""Reading cases: from a text or tables to dotted keys, overrides, and from keys to a ``Case``."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ringwear_par.cases.case import Case, Load, Output, Overrides, Ring, Stepping
from ringwear_par.cases.faults import (
    Origin,
    check_contact,
    contact_faces,
    joint_faults,
)
from ringwear_par.cases.keys import (
    flatten,
    in_full,
    override,
    parse_overrides,
    read_keys,
    refuse_study,
)
from ringwear_par.cases.laws import read_law
from ringwear_par.cases.schema import BY_PATH, KEYS, TABLES
from ringwear_par.cases.suggestions import nearest_key
from ringwear_par.cases.text import shortened, toml_text
from ringwear_par.cases.units import without_units
from ringwear_par.cases.values import RejectedError
from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.elasticity.sections import Grip, Polyline
from ringwear_par.errors import InputError, legible
from ringwear_par.schedules import Quantity, Table
from ringwear_par.textfiles import read_text
from ringwear_par.wear.law import Law

_WEAR = ("wear.lower", "wear.upper")


def read_case(source: str | Path | Mapping[str, Any], overrides: Overrides = ()) -> Case:
    """Read a case and its overrides. Not collective.

    Parameters
    ----------
    source : the name of a case file, or its tables as a dict: nested, or with dotted keys. Files
        that it names are looked for in the folder of the case file, or the current one.
    overrides : dotted keys and values, as a dict or as "KEY=VALUE" texts; files that they name are
        looked for in the current folder. None takes a key or a table away. See ``override`` for
        their rules.

    Raises
    ------
    InputError : all faults, one sentence each.
    """
    if not isinstance(source, Mapping):
        path = Path(source)
        return parse_case(read_text(path), str(path), overrides, path.parent)
    refuse_study(source, "case")
    keys = override({}, in_full(flatten(source, "case"), Path()))
    return _changed(keys, "case", overrides, None)


def parse_case(text: str, name: str, overrides: Overrides = (), folder: Path | None = None) -> Case:
    """Make a case of a TOML text; ``name`` is what messages call it. Not collective.

    Files that it names are looked for in ``folder``; the case's own text then has them in full.

    Raises
    ------
    InputError : all faults, one sentence each.
    """
    keys = read_keys(text, name)
    found = in_full(keys, folder) if folder is not None else keys
    return _changed(found, name, overrides, text if found == keys else None)


def _changed(keys: Mapping[str, Any], name: str, overrides: Overrides, text: str | None) -> Case:
    if isinstance(overrides, Mapping):
        setting, changes = "override", flatten(overrides, "overrides")
    else:
        setting, changes = "--set", flatten(parse_overrides(overrides), "--set")
    if not changes:
        return make_case(keys, name, text)
    merged = override(keys, in_full(changes, Path()))
    return make_case(merged, Origin(name, frozenset(changes), setting))


def make_case(keys: Mapping[str, Any], origin: Origin | str, text: str | None = None) -> Case:
    """Make a case of dotted keys and raw values. Not collective.

    Parameters
    ----------
    keys : dotted keys and values, as TOML gives them.
    origin : what messages call the case.
    text : the case's TOML text, if it is not to be made of the keys.

    Raises
    ------
    InputError : all faults, one sentence each.
    """
    origin = Origin(origin) if isinstance(origin, str) else origin
    values, faults = _read_values(keys, origin)
    faults += joint_faults(origin, keys, values)
    laws = [read_law(origin.name, table, keys, values, faults) for table in _WEAR]
    faces = contact_faces(origin.whole, values, faults)
    if faults:
        raise InputError(*faults)
    case = _build(values, laws, faces, toml_text(keys) if text is None else text)
    check_contact(origin.whole, case, values["load.displacement"])
    object.__setattr__(case, "rebuild", _rebuilt)  # a copy by dataclasses.replace has none
    return case


def _rebuilt(text: str, changes: Overrides) -> Case:
    return parse_case(text, "case", changes)


def _read_values(keys: Mapping[str, Any], origin: Origin) -> tuple[dict[str, Any], list[str]]:
    """Return what the keys hold, with defaults, and the faults of each by itself."""
    faults: list[str] = []
    values: dict[str, Any] = {}
    for path, value in keys.items():
        key = BY_PATH.get(path)
        if key is not None:
            try:
                values[path] = key.read(without_units(key, value))
            except RejectedError as reason:
                why = f"{key.rule} ({reason})" if str(reason) else key.rule
                faults.append(f"{origin.of(path)}{path} = {shortened(value)}: {why}")
        elif path in TABLES:
            said = f"{path} = {shortened(value)}"
            faults.append(f"{origin.of(path)}{said}: must be a table, [{path}]")
        else:
            faults.append(f"{origin.of(path)}{legible(path)}: unknown key{nearest_key(path)}")
    for key in KEYS:
        if key.path not in keys:
            if key.default is not ...:
                values[key.path] = key.default
            else:
                faults.append(f"{origin.name}: {key.path} is missing: {key.rule}")
    return values, faults


def _build(
    values: Mapping[str, Any],
    laws: Sequence[Law | None],
    faces: Mapping[str, Polyline],
    text: str,
) -> Case:
    def ring(which: str, grip: Grip) -> Ring:
        r, z, young, poisson = (values[f"{which}.{k}"] for k in ("r", "z", "young", "poisson"))
        return Ring(r, z, young, poisson, grip, faces[which], values[f"{which}.density"])

    case = Case(
        lower=ring("lower", "clamped"),
        upper=ring("upper", values["upper.grip"]),
        friction=values["contact.friction"],
        wear_lower=laws[0],
        wear_upper=laws[1],
        load=Load(values["load.omega"], values["load.force"], values["load.displacement"]),
        time=_stepping(values),
        mesh=Mesh(
            values["mesh.contact_elements"],
            values["mesh.grading"],
            values["mesh.quadrature_tolerance"],
            values["mesh.contact"],
            values["mesh.geometry"],
            values["mesh.geometry_tolerance"],
        ),
        output=Output(
            values["output.every"],
            values["output.fields"],
            values["output.profiles"],
            values["output.times"] or (),
            values["output.boundary"],
        ),
        title=values["title"],
        text=text,
    )
    if values["load.pressure"] is not None:
        pressure, area = values["load.pressure"], case.area
        force: Quantity = (
            Table(pressure.x, tuple(area * p for p in pressure.y))
            if isinstance(pressure, Table)
            else pressure * area
        )
        case = replace(case, load=Load(case.load.omega, force))
    return case


def _stepping(values: Mapping[str, Any]) -> Stepping:
    scheme, step, steps = (values[f"time.{key}"] for key in ("scheme", "step", "steps"))
    if scheme != "adaptive":
        return Stepping(scheme, step, steps)
    end = values["time.end"]
    return Stepping(
        scheme,
        until=step * steps if end is None else end,
        tolerance=values["time.tolerance"],
        pressure_tolerance=values["time.pressure_tolerance"],
    )
