"""``[[experiment.input]]``: what a rig measured of a test's case, as tables in time of its keys."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.columns import FileStore, read_intervals
from ringwear_par.cases.tables import TableReader
from ringwear_par.errors import Fault
from ringwear_par.files.smoothing import MOST_POINTS
from ringwear_par.identification.definition.data_sources import read_readings
from ringwear_par.identification.definition.problem import MeasuredInput, Prior
from ringwear_par.identification.definition.schema import (
    FEWEST_READINGS,
    INPUT_KEYS,
    read_all,
    reader_of,
)
from ringwear_par.identification.definition.series import (
    check_times,
    is_outside,
    refuse_readings,
    rounded_end,
)
from ringwear_par.schedules import in_time, points_of

#: share of the test that an input must cover
_COVERED = 0.95
#: coefficients of friction, from rolling to clean metals; others are likely in another unit
_FRICTIONS = 1e-3, 2.0


def input_keys(tables: Any) -> list[str]:
    """Return the keys of the inputs of an experiment, as far as they are right."""
    entries = tables if isinstance(tables, list) else []
    keys = [entry.get("key") for entry in entries if isinstance(entry, Mapping)]
    return [key for key in keys if key in INPUT_KEYS]


def read_inputs(
    place: str, tables: Any, case: Case | None, files: FileStore, faults: list[str]
) -> tuple[tuple[MeasuredInput, ...], Case | None]:
    """Return the inputs of an experiment, and its case with them in their places.

    None, and faults, where one is wrong, or without a case, which has numbers in the places of what
    was measured.
    """
    if not isinstance(tables, list):
        faults.append(f"{place}: input: must be tables, [[experiment.input]]")
        return (), None
    before, curves, inputs = len(faults), dict[str, Any](), list[MeasuredInput]()
    read = [_input(f"{place}: input {i}", table, case, files, faults)
            for i, table in enumerate(tables, start=1)]  # fmt: skip
    every = [entry for entry in read if entry is not None]
    for entry in sorted(every, key=lambda entry: entry.of_torque):  # its friction needs the load
        if case is not None and entry.of_torque:
            _check_friction(place, entry, case, faults)
        if case is None or len(faults) > before:
            return (), None
        inputs.append(_with_suspicion(replace(entry, radius=0.5 * sum(case.contact)), case))
        curves[entry.key] = points_of(inputs[-1].curve(case))
        case = case.replace(curves)
    return tuple(inputs), case


def _input(
    place: str, table: Any, case: Case | None, files: FileStore, faults: list[str]
) -> MeasuredInput | None:
    before, reader = len(faults), reader_of("experiment.input", place, table, faults)
    key, quantity = reader.read("key"), reader.read("quantity")
    end = math.inf if case is None else case.time.end
    reader.place = place if key is None else f"{place} ({key})"
    excluded, smooth = read_intervals(reader, "exclude", "s"), reader.read("smooth")
    scale = _scale(reader)
    is_friction, readings = key == "contact.friction", None
    if key is not None and is_friction != (quantity == "torque"):
        if quantity is None:
            reader.wrong("quantity", 'must be "torque"')
        elif "quantity" in reader:
            rule = "must be absent: a load or a speed is its own quantity"
            reader.wrong("quantity", rule, "conflict")
    if key is None or "file" not in reader:  # what columns must be depends on the key
        for name in ("columns", "units"):
            reader.raw(name)
        reader.read("file")
    else:
        kind = "torque" if is_friction else key.partition(".")[2]
        readings = read_readings(reader, kind, None, end, files, plans=False)
    reader.finish()
    if readings is None or case is None or len(faults) > before:
        return None
    series = replace(readings.series, name=key, x=rounded_end(readings.series.x, end))
    series = series.part(is_outside(series.x, excluded))
    x, value = series.x, series.value
    check_times(reader, series, end)
    if len(x) < FEWEST_READINGS:
        reader.fault(f"has {len(x)} readings; must have {FEWEST_READINGS} at least")
    elif (covered := float(np.ptp(x)) / end) < _COVERED and not files.growing:
        reader.fault(
            f"readings from {x[0]:g} to {x[-1]:g} s cover {100.0 * covered:.3g} % of the test; "
            f"must cover {100.0 * _COVERED:g} % at least"
        )
    if smooth == "none" and len(x) > MOST_POINTS:
        reader.wrong("smooth", f'must be "auto" or a time with more than {MOST_POINTS} readings')
    low = value <= 0.0 if is_friction else value < 0.0
    hint = "look at its sign" if low.all() else "exclude leaves out times of stops, say"
    rule = f"must be {'>' if is_friction else '>='} 0; {hint}"
    refuse_readings(reader, series, low, f"{{value:g}} {series.unit}", rule)
    return MeasuredInput(key, series, smooth, scale) if len(faults) == before else None


def _scale(reader: TableReader) -> Prior | None:
    """Return the prior of a factor on the readings, if there is one."""
    if (entry := reader.raw("scale")) is None:
        return None
    place = f"{reader.place}: scale"
    scale_reader, (scale,) = read_all("experiment.input.scale", place, entry, reader.faults)
    if scale is not None and scale.mean <= 0.0:
        scale_reader.wrong("prior", "must have a mean > 0")
    return cast("Prior | None", scale)


def _with_suspicion(entry: MeasuredInput, case: Case) -> MeasuredInput:
    """Return an input with a sentence about a friction that is likely in another unit, if it is."""
    typical, (low, high), series = float(np.median(entry.readings(case))), _FRICTIONS, entry.series
    if not entry.of_torque or low <= typical <= high:
        return entry
    suspicion = (
        f"{series.file}: readings in {series.unit} mean a friction of {typical:.3g}, where "
        f"contacts have {low:g} to {high:g}; look at the unit of the torque, and at the load"
    )
    return replace(entry, series=replace(series, suspicions=(*series.suspicions, suspicion)))


def _check_friction(place: str, entry: MeasuredInput, case: Case, faults: list[str]) -> None:
    """Refuse a torque whose load is not known, or 0."""
    force = case.load.force
    if force is None:
        sentence = f'{place}: input ({entry.key}): needs load.control = "force"'
        faults.append(Fault(sentence, "experiment.input.key", "conflict"))
    elif (no_load := np.asarray(in_time(force, entry.series.x)) <= 0.0).any():
        first = entry.series.x[no_load][0]
        faults.append(
            f"{place}: input ({entry.key}): the load is 0 at {first:g} s; exclude must leave out "
            "readings without load"
        )
