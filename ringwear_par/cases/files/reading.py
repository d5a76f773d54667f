"""Reading cases: from a text or tables to dotted keys, overrides, and from keys to a ``Case``."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

from ringwear_par.cases.case import (
    Case,
    Grid,
    Load,
    Output,
    Overrides,
    Ring,
    RingLayer,
    Stepping,
    Stress,
)
from ringwear_par.cases.files.faults import (
    Origin,
    check_contact,
    contact_faces,
    joint_faults,
    layer_faults,
)
from ringwear_par.cases.files.key_values import read_law, read_values
from ringwear_par.cases.files.keys import (
    flatten,
    in_full,
    keys_with_units,
    naming,
    override,
    parse_overrides,
    read_keys,
    refuse_study,
    replacing_tables,
)
from ringwear_par.cases.law import Law
from ringwear_par.cases.layers import LAYERS, expanded, layer_tables
from ringwear_par.cases.schema import SCHEMES, STOP_CRITERIA
from ringwear_par.cases.stress_points import check_stress
from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.elasticity.sections import Polyline
from ringwear_par.errors import InputError
from ringwear_par.files.text import read_text, toml_text
from ringwear_par.schedules import Quantity, Table

T = TypeVar("T")

_WEAR = ("wear.lower", "wear.upper")


def read_case(source: str | Path | Mapping[str, Any], overrides: Overrides = ()) -> Case:
    """Read a case and its overrides. Not collective.

    Parameters
    ----------
    source : the name of a case file, or its tables as a dict: nested, or with dotted keys. Files
        that it names are looked for in the folder of the case file, or the current one.
    overrides : dotted keys and values, as a dict or as "KEY=VALUE" texts; files that they name are
        looked for in the current folder. A table takes the place of the one before; None takes a
        key or a table away. See ``override`` for their rules.

    Returns
    -------
    Case : immutable; ``replace`` returns a changed one.

    Raises
    ------
    InputError : all faults, one sentence each.

    Examples
    --------
    >>> import ringwear_par as rw
    >>> case = rw.read_case("scripts/cases/paper.toml", {"wear.lower.k": "1e-5 mm3/(N m)"})
    >>> case.wear_lower
    threshold(k=1e-08, p0=40.0)
    """
    if not isinstance(source, Mapping):
        path = Path(source)
        return parse_case(read_text(path), str(path), overrides, path.parent)
    refuse_study(source, "case")
    keys_of_source = flatten(source, "case")
    with naming("case:"):
        keys = override({}, in_full(keys_of_source, Path()))
    return _changed(keys, "case", overrides, None, keys_with_units(keys_of_source))


def parse_case(text: str, name: str, overrides: Overrides = (), folder: Path | None = None) -> Case:
    """Make a case of a TOML text; ``name`` is what messages call it. Not collective.

    Files that it names are looked for in ``folder``; the case's own text then has them in full.

    Raises
    ------
    InputError : all faults, one sentence each.
    """
    keys = read_keys(text, name)
    with naming(f"{name}:"):
        complete = in_full(keys, folder) if folder is not None else keys
    own_text = text if complete == keys else None
    return _changed(complete, name, overrides, own_text, keys_with_units(keys))


def _changed(
    keys: Mapping[str, Any],
    name: str,
    overrides: Overrides,
    text: str | None,
    with_units: frozenset[str],
) -> Case:
    """Make a case of dotted keys and overrides; ``with_units``: which of these keys had units."""
    if isinstance(overrides, Mapping):
        setting, changes = "override", replacing_tables(overrides, "overrides")
    else:
        setting, changes = "--set", replacing_tables(parse_overrides(overrides), "--set")
    if not changes:
        return make_case(keys, name, text, with_units)
    with naming(setting):
        merged = override(keys, in_full(changes, Path()))
    with_units = (with_units - changes.keys()) | keys_with_units(changes)
    return make_case(merged, Origin(name, frozenset(changes), setting), None, with_units)


def make_case(
    keys: Mapping[str, Any],
    origin: Origin | str,
    text: str | None = None,
    with_units: frozenset[str] = frozenset(),
) -> Case:
    """Make a case of dotted keys and raw values. Not collective.

    Parameters
    ----------
    keys : dotted keys and values, as TOML gives them.
    origin : what messages call the case.
    text : the case's TOML text, if it is not to be made of the keys.
    with_units : keys whose numbers were written with a unit.

    Raises
    ------
    InputError : all faults, one sentence each.
    """
    origin = Origin(origin) if isinstance(origin, str) else origin
    values, faults = read_values(keys, origin)
    faults += joint_faults(origin, keys, values)
    laws = [read_law(origin.name, table, keys, values, faults) for table in _WEAR]
    faces = contact_faces(origin.whole, values, faults)
    layers = {path: _read_layers(origin, path, keys, values, faults) for path in LAYERS}
    faults += layer_faults(origin.whole, values, faces, layers)
    if faults:
        raise InputError(*faults)
    case = _build(values, laws, faces, layers)
    stress = _stress(values) if any(path.startswith("stress.") for path in keys) else None
    text = toml_text(keys) if text is None else text
    case = replace(case, stress=stress, text=text, with_units=with_units)
    check_contact(origin.whole, case, values["load.displacement"])
    check_stress(origin.whole, case)
    object.__setattr__(case, "rebuild", _rebuilt)  # a copy by dataclasses.replace has none
    return case


def _rebuilt(text: str, changes: Overrides) -> Case:
    return parse_case(text, "case", changes)


def _read_layers(
    origin: Origin,
    path: str,
    keys: Mapping[str, Any],
    values: Mapping[str, Any],
    faults: list[str],
) -> tuple[RingLayer, ...]:
    """Return the layers of a body as far as they are right; add to the faults."""
    layers, raw = [], expanded(keys)
    for table in layer_tables(keys):
        if table.startswith(path):
            law = read_law(origin.name, f"{table}.wear", raw, values, faults)
            if values.keys() >= {f"{table}.{name}" for name in ("thickness", "young", "poisson")}:
                layers.append(_of_keys(RingLayer, table, values, wear=law))
    return tuple(layers)


def _of_keys(kind: type[T], table: str, values: Mapping[str, Any], **more: Any) -> T:
    """Return a dataclass whose fields are called as the keys of a table, and ``more``."""
    keys = {field.name: f"{table}.{field.name}" for field in fields(kind)}  # type: ignore[arg-type]
    read = {name: values[key] for name, key in keys.items() if key in values}
    return kind(**{**read, **more})


def _build(
    values: Mapping[str, Any],
    laws: Sequence[Law | None],
    faces: Mapping[str, Polyline],
    layers: Mapping[str, tuple[RingLayer, ...]],
) -> Case:
    def ring(body: str, **grip: Any) -> Ring:
        body_layers = layers[f"{body}.layers"]
        return _of_keys(Ring, body, values, face=faces[body], layers=body_layers, **grip)

    case = Case(
        lower=ring("lower", grip="clamped"),
        upper=ring("upper"),
        friction=values["contact.friction"],
        wear_lower=laws[0],
        wear_upper=laws[1],
        load=_of_keys(Load, "load", values),
        time=_stepping(values),
        mesh=_of_keys(Mesh, "mesh", values),
        output=_of_keys(Output, "output", values, times=values["output.times"] or ()),
        stop=tuple(
            (name, limit) for name in STOP_CRITERIA if (limit := values[f"stop.{name}"]) is not None
        ),
        title=values["title"],
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


def _stress(values: Mapping[str, Any]) -> Stress:
    grid = _of_keys(Grid, "stress.grid", values) if values["stress.grid.n"] else None
    return _of_keys(Stress, "stress", values, points=values["stress.points"] or (), grid=grid)


def _stepping(values: Mapping[str, Any]) -> Stepping:
    if not SCHEMES[values["time.scheme"]].adaptive:
        return _of_keys(Stepping, "time", values)
    end = values["time.end"]
    if end is None:
        end = values["time.step"] * values["time.steps"]
    return _of_keys(Stepping, "time", values, step=0.0, steps=0, until=end)
