"""Random parts of tests: ``scatter`` of fitted keys, and ``fit.process``, of the wear itself.

Values of keys differ between specimens, batches and laboratories.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ringwear_par.cases.tables import name_unknown_keys
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
from ringwear_par.identification.definition.schema import keys_of, read_all, reader_of
from ringwear_par.studies.variations import unnested

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
    reader = reader_of("fit.parameters.KEY.scatter", f"{place}.scatter", table, faults)
    before = len(faults)
    size_unit = "1" if log else unit
    read = {group: reader.read(group, unit=size_unit) for group in GROUPS}
    sizes = {group: size for group, size in read.items() if size is not None}
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
    groups = zip(*(experiment.groups for experiment in experiments), strict=True)
    names = dict(zip(GROUPS, groups, strict=True))
    for group in GROUPS[1:]:
        seen: dict[str, str] = {}
        for specimen, label in zip(names["specimen"], names[group], strict=True):
            if seen.setdefault(specimen, label) != label:
                faults.append(
                    f'{name}: specimen "{legible(specimen)}" is of {group} "{legible(label)}" and '
                    f'of "{legible(seen[specimen])}"; must be of one {group}'
                )
    for key, group in fitted:
        if (count := len({*names[group]})) == 1:
            plural = PLURALS[group]
            faults.append(
                f"{name}: scatter of {key} between {plural} cannot be fitted to one "
                f"{group}; must be a number, or there must be at least 2 {plural}"
            )
        for small in GROUPS[: GROUPS.index(group)]:
            if (key, small) in fitted and len(
                {*zip(names[small], names[group], strict=True)}
            ) == count:
                faults.append(
                    f"{name}: scatter of {key}: {group} and {small} are the same groups; "
                    'only one of the two can be "fit"'
                )


def read_process(place: str, table: Any, faults: list[str]) -> dict[str, ProcessNoise]:
    """Return the process noise by key ("wear.lower"), and add faults of it to the others."""
    if not isinstance(table, Mapping):
        faults.append(f"{place} = {shortened(table)}: must be a table of wear.lower, wear.upper")
        return {}
    entries = unnested(table, keys_of("fit.process.KEY").keys())
    name_unknown_keys(place, entries, _RANDOM, faults, table="fit.process")
    noises = {
        key: _read_noise(f"{place}.{key}", entries[key], faults)
        for key in _RANDOM
        if key in entries
    }
    return {key: noise for key, noise in noises.items() if noise is not None}


def _read_noise(place: str, value: Any, faults: list[str]) -> ProcessNoise | None:
    before = len(faults)
    if not isinstance(value, Mapping) and value != "fit":
        rule = 'must be "fit", or a table of size or share, and prior'
        faults.append(f"{place} = {shortened(value)}: {rule}")
        return None
    table = {"size": "fit"} if value == "fit" else value
    reader, (size, share, scale) = read_all("fit.process.KEY", place, table, faults)
    if len(faults) == before and (size is None) == (share is None):
        reader.fault("must have one of size and share", code="missing")
    if scale is not None and size != "fit":
        reader.wrong("prior", 'must be absent where the size is not "fit"', "conflict")
    known = size if isinstance(size, float) else None
    noise = ProcessNoise(known, share)
    return noise if scale is None else replace(noise, scale=scale)


def check_process(problem: Problem, faults: list[str]) -> None:
    """Add what readings cannot tell of wear's own noise to the faults."""
    name, experiments = problem.name, problem.experiments
    series = [(experiment.name, one) for experiment in experiments for one in experiment.series]
    bodies = [body_of_wear(key) for key in problem.settings.process] if experiments else []
    for body in bodies:
        key = f"fit.process.wear.{body}"
        if all(experiment.case.laws[BODIES.index(body)] is None for experiment in experiments):
            faults.append(f"{name}: {key}: {body} does not wear; must be a body with a wear law")
        elif not any(one.tells_wear(body) for _, one in series):
            faults.append(
                f"{name}: {key}: no reading is of a depth, mass, volume or profile of {body}; must "
                "have one at least"
            )
    for test, one in series:
        length = float(np.ptp(one.x))  # s
        correlated = one.correlation_time > _LONGEST_CORRELATION * length
        if correlated and any(map(one.tells_wear, bodies)):
            faults.append(
                f'{name}: experiment "{legible(test)}": {one.name}: correlation_time = '
                f"{one.correlation_time:g}: cannot be told from wear's own noise (fit.process); "
                f"must be at most {_LONGEST_CORRELATION:g} of the record, {length:g} s"
            )
