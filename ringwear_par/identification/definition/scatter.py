"""Random parts of tests: ``scatter`` of fitted keys, and ``fit.process``, of the wear itself.

Values of keys differ between specimens, batches and laboratories.
"""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from ringwear_par.cases.tables import TableReader, name_unknown_keys
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import legible
from ringwear_par.files.text import shortened
from ringwear_par.identification.definition.problem import (
    GROUPS,
    Problem,
    ProcessNoise,
    Scatter,
    body_of_wear,
)
from ringwear_par.identification.definition.schema import PROCESS, SCATTER

#: scale of the prior of fitted sizes of scatter, of keys whose logarithms scatter
_LOG_SCALE = 0.3
#: largest size of scatter of a logarithm: a factor of 20 is no scatter of one material
_LARGEST = 3.0
#: most sizes that one fit may estimate: readings of more tell little but their priors
_MOST_FITTED = 3
#: what the machine is set to is the same for all specimens
_SETTINGS = ("load.",)
#: of the names of groups
PLURALS = {"specimen": "specimens", "batch": "batches", "lab": "laboratories"}
#: tables of wear that may be random
_RANDOM = tuple(f"wear.{body}" for body in BODIES)
#: a size that is written with the sign of per cent
_PERCENT = re.compile(r"(\d+(?:\.\d+)?) *%")
#: largest correlation time, as a share of a record: noise that is correlated for longer looks like
#: wear
_LONGEST_CORRELATION = 0.1


def read_scatter(
    place: str, key: str, value: Any, log: bool, unit: str, faults: list[str]
) -> Scatter | None:
    """Return the scatter of a fitted key, and add what is wrong with it to the faults."""
    if value is None:
        return None
    if key.startswith(_SETTINGS):
        faults.append(
            f"{place}: scatter: {key} is set by the machine, not by the specimen; must be a key of "
            "a wear law, contact.friction, a modulus or a layer"
        )
        return None
    table = value if isinstance(value, Mapping) else {"specimen": value}
    reader = TableReader(f"{place}.scatter", table, faults, SCATTER)
    before = len(faults)
    size_unit = "1" if log else unit
    sizes = {}
    for group in GROUPS:
        percent = _PERCENT.fullmatch(str(reader.raw(group, "")))
        if percent is not None and log:
            reader.wrong(group, f"must be {float(percent[1]) / 100.0:g}, which is {percent[0]}")
        elif group in reader:
            sizes[group] = reader.read(group, unit=size_unit)
    scale, start = (reader.read(name, unit=size_unit) for name in ("prior", "start"))
    reader.finish()
    if not sizes and len(faults) == before:
        reader.fault(f"must have one of {', '.join(GROUPS)}")
    for name, size in {**sizes, "prior": scale}.items() if log else ():
        if isinstance(size, float) and size > _LARGEST:
            reader.wrong(
                name, f"must be at most {_LARGEST:g} (standard deviation of the logarithm)"
            )
    if not log and scale is None and "fit" in sizes.values():
        reader.wrong(
            "prior", f'must be {{ half_t = scale }} in {unit} where scale = "linear" and the '
            'scatter is "fit"'
        )  # fmt: skip
    if len(faults) > before:
        return None
    scale = _LOG_SCALE if scale is None else scale
    known = {group: size if isinstance(size, float) else None for group, size in sizes.items()}
    return Scatter(known, scale, 0.5 * scale if start is None else start)


def check_scatter(problem: Problem, faults: list[str]) -> None:
    """Add what readings cannot tell of the scatters to the faults."""
    name, experiments, settings = problem.name, problem.experiments, problem.settings
    scatters = [(p.key, p.scatter) for p in problem.parameters if p.scatter is not None]
    fitted = [(key, group) for key, s in scatters for group, v in s.sizes.items() if v is None]
    count = len(fitted) + sum(noise.fitted for noise in settings.process.values())
    if count > _MOST_FITTED:
        faults.append(
            f'{name}: {count} sizes of scatter and process are "fit"; must be at most '
            f"{_MOST_FITTED}"
        )
    if not scatters or not experiments:
        return
    if all(s.censored is not None and s.censored.all() for e in experiments for s in e.series):
        faults.append(
            f"{name}: all readings are limits, which tell nothing of keys with scatter; some must "
            "be values, or scatter absent"
        )
    for group, place in (("batch", 1), ("lab", 2)):
        seen: dict[str, str] = {}
        for experiment in experiments:
            specimen, label = experiment.groups[0], experiment.groups[place]
            if seen.setdefault(specimen, label) != label:
                faults.append(
                    f'{name}: specimen "{legible(specimen)}" is of {group} "{legible(label)}" and '
                    f'of "{legible(seen[specimen])}"; must be of one {group}'
                )
    names = {group: [e.groups[place] for e in experiments] for place, group in enumerate(GROUPS)}
    for key, group in fitted:
        if len({*names[group]}) == 1:
            plural = PLURALS[group]
            faults.append(
                f"{name}: scatter of {key} between {plural} cannot be fitted to one "
                f"{group}; must be a number, or there must be at least 2 {plural}"
            )
    for key, scatter in scatters:
        fits = [group for group, size in scatter.sizes.items() if size is None]
        for i, small in enumerate(fits):
            for large in fits[i + 1 :]:
                if len({*zip(names[small], names[large], strict=True)}) == len({*names[large]}):
                    faults.append(
                        f"{name}: scatter of {key}: {large} and {small} are the same groups; "
                        'only one of the two can be "fit"'
                    )


def read_process(place: str, table: Any, faults: list[str]) -> dict[str, ProcessNoise]:
    """Return the process noise by key ("wear.lower"), and add faults of it to the others."""
    if not isinstance(table, Mapping):
        faults.append(f"{place} = {shortened(table)}: must be a table of wear.lower, wear.upper")
        return {}
    flat = dict(table)
    if isinstance(nested := flat.pop("wear", None), Mapping):  # written without quotes
        flat |= {f"wear.{body}": value for body, value in nested.items()}
    name_unknown_keys(place, flat, _RANDOM, faults, table="fit.process")
    entries = {
        key: _read_noise(f"{place}.{key}", flat[key], faults) for key in _RANDOM if key in flat
    }
    return {key: noise for key, noise in entries.items() if noise is not None}


def _read_noise(place: str, value: Any, faults: list[str]) -> ProcessNoise | None:
    before = len(faults)
    if not isinstance(value, Mapping) and value != "fit":
        rule = 'must be "fit", or a table of size or share, and prior'
        faults.append(f"{place} = {shortened(value)}: {rule}")
        return None
    reader = TableReader(place, {"size": "fit"} if value == "fit" else value, faults, PROCESS)
    size, share, scale = (reader.read(name) for name in PROCESS)
    reader.finish()
    if len(faults) == before and (size is None) == (share is None):
        reader.fault("must have one of size and share", code="missing")
    if scale is not None and size != "fit":
        reader.wrong("prior", 'must be absent where the size is not "fit"', "conflict")
    if len(faults) > before:
        return None
    known = size if isinstance(size, float) else None
    return ProcessNoise(known, share, **({} if scale is None else {"scale": scale}))


def check_process(problem: Problem, faults: list[str]) -> None:
    """Add what readings cannot tell of wear's own noise to the faults."""
    name, experiments, settings = problem.name, problem.experiments, problem.settings
    process = settings.process
    if not process or not experiments:
        return
    for key in process:
        body = body_of_wear(key)
        if all(experiment.case.laws[BODIES.index(body)] is None for experiment in experiments):
            faults.append(
                f"{name}: fit.process.{key}: {body} does not wear; must be a body with a wear law"
            )
        elif not any(
            series.tells_wear(body) for experiment in experiments for series in experiment.series
        ):
            faults.append(
                f"{name}: fit.process.{key}: no reading is of a depth, mass, volume or profile of "
                f"{body}; must have one at least"
            )
    for experiment in experiments:
        for series in experiment.series:
            wear = any(series.tells_wear(body_of_wear(key)) for key in process)
            length = float(np.ptp(series.x))  # s
            if wear and series.correlation_time > _LONGEST_CORRELATION * length:
                faults.append(
                    f'{name}: experiment "{legible(experiment.name)}": {series.name}: '
                    f"correlation_time = {series.correlation_time:g}: cannot be told from wear's "
                    f"own noise (fit.process); must be at most {_LONGEST_CORRELATION:g} of the "
                    f"record, {length:g} s"
                )
