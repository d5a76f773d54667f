"""``[[experiment.input]]``: what a rig measured of a test's case, as tables in time of its keys."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.columns import FileStore, read_intervals
from ringwear_par.cases.tables import TableReader
from ringwear_par.files.smoothing import MOST_POINTS
from ringwear_par.identification.definition.data_sources import read_readings, warn_once
from ringwear_par.identification.definition.problem import MeasuredInput
from ringwear_par.identification.definition.schema import FEWEST_READINGS, refuse
from ringwear_par.identification.definition.series import (
    check_times,
    is_outside,
    refuse_readings,
)
from ringwear_par.schedules import in_time

#: share of the test that an input must cover
_COVERED = 0.95
#: coefficients of friction, from rolling to clean metals; others are likely in another unit
_FRICTIONS = 1e-3, 2.0


def read_inputs(
    readers: Sequence[tuple[str | None, TableReader]], case: Case | None, files: FileStore
) -> tuple[tuple[MeasuredInput, ...], Case | None]:
    """Return the inputs of an experiment that are right, and its case with them in their places.

    Parameters
    ----------
    readers : of their tables, each with its key; None of a wrong one.
    case : has numbers in the places of what was measured.
    """
    inputs = list[MeasuredInput]()
    # friction needs the load
    for key, reader in sorted(readers, key=lambda entry: entry[0] == "contact.friction"):
        entry = _input(key, reader, case, files)
        if case is not None and entry is not None:
            inputs.append(entry)
            case = entry.applied(case)
    return tuple(inputs), case


def _input(
    key: str | None, reader: TableReader, case: Case | None, files: FileStore
) -> MeasuredInput | None:
    """Return an input, whose readings must be allowed in the case; None, and faults, of others."""
    if key is None:
        return None
    before, of_torque = len(reader.faults), key == "contact.friction"
    end = math.inf if case is None else case.time.end
    reader.place = f"{reader.place} ({key})"
    excluded = read_intervals(reader, "exclude", "s")
    smooth, scale = reader.read("smooth"), reader.read("scale")
    if of_torque and "quantity" not in reader:
        reader.wrong("quantity", 'must be "torque"')
    elif not of_torque:
        refuse(reader, "of a load or a speed, which is its own quantity", "quantity")
    reader.read("quantity")
    kind = "torque" if of_torque else key.partition(".")[2]
    read = read_readings(reader, kind, end, files)
    reader.finish()
    if read is None or case is None or len(reader.faults) > before:
        return None
    series = replace(read[0], name=key).part(is_outside(read[0].x, excluded))
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
    low = value <= 0.0 if of_torque else value < 0.0
    hint = "look at its sign" if low.all() else "exclude leaves out times of stops, say"
    rule = f"must be {'>' if of_torque else '>='} 0; {hint}"
    refuse_readings(reader, series, low, f"{{value:g}} {series.unit}", rule)
    force = case.load.force
    if of_torque and force is None:
        reader.fault('needs load.control = "force"', "key", "conflict")
    elif of_torque and force is not None and (no_load := in_time(force, x) <= 0.0).any():
        first = f"the load is 0 at {x[no_load][0]:g} s"
        reader.fault(f"{first}; exclude must leave out readings without load")
    if len(reader.faults) > before:
        return None
    entry = MeasuredInput(key, series, smooth, scale, 0.5 * sum(case.contact))
    typical, (least, most) = float(np.median(entry.readings(case))), _FRICTIONS
    if of_torque and not least <= typical <= most:
        warn_once(
            f"{series.file}: readings in {series.unit} mean a friction of {typical:.3g}, where "
            f"contacts have {least:g} to {most:g}; look at the unit of the torque, and at the load"
        )
    return entry
