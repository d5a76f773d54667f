"""Random parts of tests: ``scatter`` of fitted keys, and ``fit.process``, of the wear itself.

Values of keys differ between specimens, batches and laboratories.
"""

from collections.abc import Mapping

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
from ringwear_par.identification.definition.schema import keys_of, read_all, reader_of, refuse
from ringwear_par.studies.variations import unnested

#: scale of the prior of fitted sizes of scatter, of keys whose logarithms scatter
_LOG_SCALE = 0.3
#: largest size of scatter of a logarithm: a factor of 20 is no scatter of one material
_LARGEST = 3.0
#: most sizes that one fit may estimate: readings of more tell little but their priors
_MOST_FITTED = 3
#: of the names of groups
PLURALS = {"specimen": "specimens", "batch": "batches", "lab": "laboratories"}
#: tables of wear that may be random
RANDOM = tuple(f"wear.{body}" for body in BODIES)
#: largest correlation time, as a share of a record: noise that is correlated for longer looks like
#: wear
_LONGEST_CORRELATION = 0.1


def read_scatter(parameter: TableReader, key: str, log: bool, unit: str) -> Scatter | None:
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
    read = {group: reader.read(group, unit=unit) for group in GROUPS}
    sizes = {group: size for group, size in read.items() if size is not None}
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
    scale = scale or _LOG_SCALE
    known = {group: None if size == "fit" else size for group, size in sizes.items()}
    return Scatter(known, scale, start or 0.5 * scale)


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
    if not scatters:
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
        count, plural = len({*names[group]}), PLURALS[group]
        if count == 1:
            faults.append(
                f"{name}: scatter of {key} between {plural} cannot be fitted to one "
                f"{group}; must be a number, or there must be at least 2 {plural}"
            )
        for small in GROUPS[: GROUPS.index(group)]:
            pairs = {*zip(names[small], names[group], strict=True)}
            if (key, small) in fitted and len(pairs) == count:
                faults.append(
                    f"{name}: scatter of {key}: {group} and {small} are the same groups; "
                    'only one of the two can be "fit"'
                )


def read_process(fit: TableReader) -> dict[str, ProcessNoise]:
    """Return the process noise by key ("wear.lower"); its faults are the reader's."""
    table = fit.raw("process", {})
    if not isinstance(table, Mapping):
        fit.wrong("process", "must be a table of wear.lower, wear.upper")
        return {}
    entries, place = unnested(table, keys_of("fit.process.KEY").keys()), f"{fit.place}.process"
    name_unknown_keys(place, entries, RANDOM, fit.faults, table="fit.process")
    return {
        key: _read_noise(f"{place}.{key}", entries[key], fit.faults)
        for key in RANDOM
        if key in entries
    }


def _read_noise(place: str, value: object, faults: list[str]) -> ProcessNoise:
    if not isinstance(value, Mapping) and value != "fit":
        rule = 'must be "fit", or a table of size or share, and prior'
        faults.append(f"{place} = {shortened(value)}: {rule}")
        return ProcessNoise()
    before, table = len(faults), {"size": "fit"} if value == "fit" else value
    reader = reader_of("fit.process.KEY", place, table, faults)
    size, share, scale = read_all(reader)
    if len(faults) == before and (size is None) == (share is None):
        reader.fault("must have one of size and share", code="missing")
    if size != "fit":
        refuse(reader, 'where the size is not "fit"', "prior")
        return ProcessNoise(size, share)
    return ProcessNoise() if scale is None else ProcessNoise(scale=scale)


def check_process(problem: Problem, faults: list[str]) -> None:
    """Add what readings cannot tell of wear's own noise to the faults."""
    name, experiments = problem.name, problem.experiments
    series = [(experiment.name, one) for experiment in experiments for one in experiment.series]
    bodies = [body_of_wear(key) for key in problem.settings.process]
    for body in bodies:
        key = f"fit.process.wear.{body}"
        if not any(experiment.case.laws[BODIES.index(body)] for experiment in experiments):
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
