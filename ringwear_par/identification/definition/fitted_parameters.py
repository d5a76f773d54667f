"""``[fit]``: which case keys are fitted, from which starts and within which bounds.

Their ``scatter`` is between specimens, batches and laboratories; ``process`` is of wear itself.
"""

import math
from collections.abc import Mapping
from typing import Any

from ringwear_par.cases.files.key_values import nearest_key
from ringwear_par.cases.numbers import interval_of
from ringwear_par.cases.schema import BY_PATH, base_unit, layer_entry
from ringwear_par.cases.smooth_keys import smooth_keys
from ringwear_par.cases.tables import TableReader, name_unknown_keys
from ringwear_par.cases.units import factor, has_unit, in_unit_where_right, number_and_unit
from ringwear_par.cases.values import RejectedError
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import Fault, legible
from ringwear_par.files.text import shortened
from ringwear_par.identification.definition.problem import (
    GROUPS,
    FittedParameter,
    Problem,
    ProcessNoise,
    Scatter,
)
from ringwear_par.identification.definition.schema import (
    check_start,
    keys_of,
    read_all,
    reader_of,
    refuse,
)
from ringwear_par.studies.variations import split_key, unnested

#: largest size of scatter of a logarithm: a factor of 20 is no scatter of one material
_LARGEST = 3.0
#: tables of wear that may be random
RANDOM = tuple(f"wear.{body}" for body in BODIES)
#: entries of layers that may be fitted, beside numbers of their laws
_ELASTIC = ("thickness", "young", "poisson")


def read_parameters(reader: TableReader) -> tuple[FittedParameter, ...]:
    """Return the fitted keys of a table; what is wrong with them is added to its faults."""
    table, faults = reader.raw("parameters"), reader.faults
    told = reader.raw("units", {}) if reader.loc == "fit" else {}
    if not isinstance(table, Mapping) or not table:
        rule = "parameters is missing or empty; must name one case key at least"
        reader.fault(rule, "parameters", "missing")
        return ()
    entries = unnested(table, keys_of("fit.parameters.KEY").keys())
    if not isinstance(told, Mapping):
        reader.wrong("units", "must be a table of units by fitted key")
    units = unnested(told, set()) if isinstance(told, Mapping) else {}
    place, known = f"{reader.place}.units", [*entries]
    name_unknown_keys(place, units, known, faults, "is not fitted", "fit.units")
    parameters = [_parameter(reader, *entry, units.get(entry[0])) for entry in entries.items()]
    return tuple(parameter for parameter in parameters if parameter is not None)


def _parameter(reader: TableReader, key: str, table: Any, told: Any) -> FittedParameter | None:
    """Return a fitted key, reported in the unit ``told`` or in that of its start."""
    place, faults, layer = reader.place, reader.faults, layer_entry(key)
    name, base, (path, part) = legible(key), base_unit(key), split_key(key)
    number = interval_of((path, part if part is None else str(part)))
    elastic = layer is not None and layer[2] in _ELASTIC
    if path.startswith("time.") or not (number or elastic):
        near = "" if path in BY_PATH else nearest_key(path)
        sentence = (
            f'{place}.parameters."{name}": cannot be fitted{near}; must be a number of a wear law, '
            "contact.friction, a load, load.omega, a modulus, or a layer's thickness or Poisson's "
            "ratio"
        )
        faults.append(Fault(sentence, f"fit.parameters.{key}", "not_allowed"))
        return None
    before = len(faults)
    written = table.get("start") if isinstance(table, Mapping) else None
    own_unit = number_and_unit(str(written))[1] if has_unit(written) else ""
    unit = own_unit if told is None else str(told)
    try:
        unit = "" if not unit or math.isclose(factor(unit, base), 1.0) else unit
    except RejectedError:  # that of the start is refused below
        if told is not None:
            state = f'{place}.units."{name}" = {shortened(told)}'
            sentence = f"{state}: must be a unit of {base or 'a parameter'}"
            faults.append(Fault(sentence, f"fit.units.{key}", "unit"))
    if base is None:  # of a user's law, whose numbers have any unit
        table = in_unit_where_right(table, None)
    entry = reader_of("fit.parameters.KEY", f'{place}.parameters."{name}"', table, faults)
    start, bounds, prior = (entry.read(name, unit=base) for name in ("start", "bounds", "prior"))
    log = entry.read("scale") == "log"
    scatter = _read_scatter(entry, key, log, base or "")
    entry.finish()
    if log and bounds is not None and bounds[0] <= 0:
        entry.wrong("bounds", 'must be two increasing numbers > 0 where scale = "log"')
    if start is not None and bounds is not None:
        check_start(entry, start, bounds)
    if len(faults) > before:
        return None
    return FittedParameter(key, start, bounds, log, prior, scatter, unit)


def _read_scatter(parameter: TableReader, key: str, log: bool, unit: str) -> Scatter | None:
    """Return the scatter of a fitted key, None where it has none; its faults are the reader's."""
    value, faults = parameter.raw("scatter"), parameter.faults
    if value is None:
        return None
    if key.startswith("load."):
        rule = f"must be absent, {key} is set by the machine, not by the specimen"
        parameter.wrong("scatter", rule, "conflict")
        return None
    table = value if isinstance(value, Mapping) else {"specimen": value}
    before, place = len(faults), f"{parameter.place}: scatter"
    reader = reader_of("fit.parameters.KEY.scatter", place, table, faults)
    unit = "1" if log else unit
    sizes = {group: size for group in GROUPS if (size := reader.read(group, unit=unit))}
    scale, start = (reader.read(name, unit=unit) for name in ("prior", "start"))
    reader.finish()
    if not sizes and len(faults) == before:
        reader.fault(f"must have one of {', '.join(GROUPS)}")
    for name, size in {**sizes, "prior": scale}.items() if log else ():
        if isinstance(size, float) and size > _LARGEST:
            rule = f"must be at most {_LARGEST:g} (standard deviation of the logarithm)"
            reader.wrong(name, rule)
    if not log and scale is None and "fit" in sizes.values():
        rule = 'where scale = "linear" and the scatter is "fit"'
        reader.wrong("prior", f"must be {{ half_t = scale }} in {unit} {rule}")
    scale = scale or Scatter.scale
    known = {group: None if size == "fit" else size for group, size in sizes.items()}
    return Scatter(known, scale, start or 0.5 * scale)


def read_process(fit: TableReader) -> dict[str, ProcessNoise]:
    """Return the process noise by key ("wear.lower"); its faults are the reader's."""
    table = fit.raw("process", {})
    if not isinstance(table, Mapping):
        fit.wrong("process", "must be a table of wear.lower, wear.upper")
        return {}
    entries, place = unnested(table, keys_of("fit.process.KEY").keys()), f"{fit.place}.process"
    name_unknown_keys(place, entries, RANDOM, fit.faults, table="fit.process")
    return {key: _read_noise(fit, key, entries[key]) for key in RANDOM if key in entries}


def _read_noise(fit: TableReader, key: str, value: object) -> ProcessNoise:
    table = {"size": "fit"} if value == "fit" else value
    reader = reader_of("fit.process.KEY", f"{fit.place}.process.{key}", table, fit.faults)
    before = len(fit.faults)
    size, share, scale = read_all(reader)
    if len(fit.faults) == before and (size is None) == (share is None):
        reader.fault('must be "fit", or have one of size and share', code="missing")
    if size != "fit":
        refuse(reader, 'where the size is not "fit"', "prior")
        return ProcessNoise(size, share)
    return ProcessNoise(scale=scale or ProcessNoise.scale)


def units_of(problem: Problem) -> dict[str, str]:
    """Return the units of the fitted keys, as laws have them, "1" for none."""
    known = smooth_keys(problem.experiments[0].case)
    return {key: "1" if known[key] == "-" else known[key] for key in problem.keys}


def unit_scale(parameter: FittedParameter) -> float:
    """Return the size of the user's unit of a fitted key in the case's unit, 1 for the same."""
    return factor(parameter.unit, base_unit(parameter.key)) if parameter.unit else 1.0
