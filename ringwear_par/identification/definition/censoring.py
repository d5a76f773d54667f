"""``censored`` readings: of which only a limit is known."""

from collections.abc import Sequence

import numpy as np

from ringwear_par.arrays import IntArray
from ringwear_par.cases.tables import TableReader
from ringwear_par.errors import legible
from ringwear_par.identification.definition.data_sources import Readings
from ringwear_par.identification.definition.problem import Experiment, Settings

#: the true value is at most the reading, at least; else the reading is one
_SIDES = {"below": -1, "above": 1, "": 0}


def read_censored(reader: TableReader, readings: Readings) -> IntArray | None:
    """Return the sides (n,) at which readings are limits: -1 at most, 1 at least; None for none."""
    word = reader.read("censored")
    if word is None:
        return None
    if word in _SIDES:
        return np.full(len(readings.value), _SIDES[word])
    data = readings.data
    if data is None or readings.rows is None or word not in data.columns:
        where = "" if data is None else f" or a column of {data.name}"
        reader.wrong("censored", f'must be "below", "above"{where}')
        return None
    place = data.columns.index(word)
    cells = [data.rows[i][place].strip() for i in np.flatnonzero(readings.rows).tolist()]
    for cell, line in zip(cells, data.lines[readings.rows].tolist(), strict=True):
        if cell not in _SIDES:
            reader.fault(
                f"{data.name}: line {line}: {legible(word)} = {legible(cell)}: must be below, "
                "above or empty"
            )
            return None
    return np.array([_SIDES[cell] for cell in cells])


def check_censored(
    name: str, settings: Settings, experiments: Sequence[Experiment], faults: list[str]
) -> None:
    """Add what does not go together with censored readings to the faults.

    Parameters
    ----------
    name : of the file.
    """
    for experiment in experiments:
        for series in experiment.series:
            if series.censored is None or not series.censored.any():
                continue
            rules = {
                "must be absent with loss = \"student\"": settings.loss == "student",
                "must be absent with process": bool(settings.process),
                "must be absent with correlation_time": series.correlation_time > 0.0,
                'needs sd as a number where all readings are: must not be "fit"':
                    series.sd_fitted and series.censored.all(),
                'must be absent with intervals = ["posterior"]': "posterior" in settings.intervals,
            }  # fmt: skip
            faults += [
                f'{name}: experiment "{legible(experiment.name)}": {series.name}: censored: {rule}'
                for rule, broken in rules.items()
                if broken
            ]
