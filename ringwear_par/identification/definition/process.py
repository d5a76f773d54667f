"""``fit.process``: bodies whose wear is itself random."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ringwear_par.cases.tables import TableReader, name_unknown_keys
from ringwear_par.elasticity.geometry.sections import BODIES
from ringwear_par.errors import legible
from ringwear_par.files.text import shortened
from ringwear_par.identification.definition.problem import (
    Experiment,
    ProcessNoise,
    Series,
    body_of_wear,
)
from ringwear_par.identification.definition.schema import PROCESS

_KEYS = tuple(f"wear.{body}" for body in BODIES)
#: of a record: noise that is correlated for longer looks like that of wear
_LONGEST_CORRELATION = 0.1


def read_process(said: str, table: Any, faults: list[str]) -> dict[str, ProcessNoise]:
    """Return the process noise by key ("wear.lower"), and add what is wrong with it to the faults.

    Parameters
    ----------
    said : how sentences about the table begin.
    """
    if not isinstance(table, Mapping):
        faults.append(f"{said} = {shortened(table)}: must be a table of wear.lower, wear.upper")
        return {}
    flat = dict(table)
    if isinstance(nested := flat.pop("wear", None), Mapping):  # written without quotes
        flat |= {f"wear.{body}": value for body, value in nested.items()}
    name_unknown_keys(said, flat, _KEYS, faults)
    entries = {key: _read_entry(f"{said}.{key}", flat[key], faults) for key in _KEYS if key in flat}
    return {key: noise for key, noise in entries.items() if noise is not None}


def _read_entry(said: str, value: Any, faults: list[str]) -> ProcessNoise | None:
    before = len(faults)
    if not isinstance(value, Mapping) and value != "fit":
        rule = 'must be "fit", or a table of size or share, and prior'
        faults.append(f"{said} = {shortened(value)}: {rule}")
        return None
    reader = TableReader(said, {"size": "fit"} if value == "fit" else value, faults, PROCESS)
    size, share, scale = (reader.read(name) for name in PROCESS)
    reader.finish()
    if len(faults) == before and (size is None) == (share is None):
        reader.fault("must have one of size and share")
    if scale is not None and size != "fit":
        reader.wrong("prior", 'must be absent where the size is not "fit"')
    if len(faults) > before:
        return None
    known = size if isinstance(size, float) else None
    return ProcessNoise(known, share, **({} if scale is None else {"scale": scale}))


def check_process(
    name: str,
    process: Mapping[str, ProcessNoise],
    experiments: Sequence[Experiment],
    intervals: Sequence[str],
    faults: list[str],
) -> None:
    """Add what readings cannot tell of wear's own noise to the faults.

    Parameters
    ----------
    name : of the file.
    intervals : that are asked for.
    """
    if not process or not experiments:
        return
    for key in process:
        body = body_of_wear(key)
        if all(one.case.laws[BODIES.index(body)] is None for one in experiments):
            faults.append(
                f"{name}: fit.process.{key}: {body} does not wear; must be a body with a wear law"
            )
        elif not any(series.tells_wear(body) for one in experiments for series in one.series):
            faults.append(
                f"{name}: fit.process.{key}: no reading is of a depth, mass, volume or profile of "
                f"{body}; must have one at least"
            )
    for experiment in experiments:
        for series in experiment.series:
            wear = any(series.tells_wear(body_of_wear(key)) for key in process)
            if wear and series.correlation_time > _LONGEST_CORRELATION * _length(series):
                faults.append(
                    f'{name}: experiment "{legible(experiment.name)}": {series.name}: '
                    f"correlation_time = {series.correlation_time:g}: cannot be told from wear's "
                    f"own noise (fit.process); must be at most {_LONGEST_CORRELATION:g} of the "
                    f"record, {_length(series):g} s"
                )
    if set(intervals) - {"linear"}:
        faults.append(
            f"{name}: fit.intervals = {list(intervals)}: are not possible with process; must be "
            '["linear"]'
        )


def _length(series: Series) -> float:
    """Return the duration of a record, s."""
    return float(np.ptp(series.x))
