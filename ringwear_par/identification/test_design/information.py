"""Information on the fitted keys: before tests (priors, an earlier fit), and what tests add."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy.stats import norm, qmc

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.units import factor
from ringwear_par.cases.values import RejectedError
from ringwear_par.errors import InputError
from ringwear_par.files.text import read_text, shortened
from ringwear_par.identification.definition.problem import (
    Experiment,
    FittedParameter,
    Problem,
    Series,
    reflected,
)
from ringwear_par.identification.definition.scatter import expected_sizes
from ringwear_par.identification.model.noise import NuisanceProjection, information_share, whitened
from ringwear_par.identification.model.readings import nuisance_columns
from ringwear_par.identification.model.rounds import Rounds
from ringwear_par.identification.scatter.likelihood import of_new_specimen
from ringwear_par.results.execution.stop_signals import StopSignals

#: number of draws of the keys, and their seed
_DRAWS, _SEED = 8, 0
#: information by the widths of bounds below which nothing is known of a direction, and below which
#: it is not drawn along; largest sd that is drawn, over these widths
_UNINFORMED, _WEAK, _WIDEST = 1e-6, 1.0, 0.25
_ALLOWED = "must be the folder of a fit of the same keys that is done (ringwear fit -o)"


@dataclass(frozen=True, eq=False)
class PriorInformation:
    """Values of the keys before tests are made, and how well they are known."""

    #: (m,) values.
    nominal: FloatArray
    #: (m, m) of the unknowns.
    information: FloatArray
    #: (d, m) values, the nominal ones first.
    draws: FloatArray
    #: the earlier fit, "" for none.
    after: str
    #: whether something is known in every direction.
    whole: bool
    #: sd that an earlier fit has found, in the data's unit, and that unit: by experiment and
    #: series.
    noise: Mapping[tuple[str, str], tuple[float, str]]
    #: (m,) variances of the unknowns between specimens
    scatter: FloatArray


def widths(problem: Problem) -> FloatArray:
    """Return (m,) between the bounds of the unknowns."""
    low, high = problem.unknown_bounds
    return high - low


def prior_information(problem: Problem, after: str | Path | None) -> PriorInformation:
    """Return the information of priors or of an earlier fit, which must be one of these keys."""
    parameters = problem.parameters
    noise: dict[tuple[str, str], tuple[float, str]] = {}
    sizes = expected_sizes(problem)
    if after is None:
        nominal = np.array([_expected(p) for p in parameters])
        pairs = zip(parameters, nominal.tolist(), strict=True)
        by = [0.0 if p.prior is None else p.slope(v) / p.prior.sd for p, v in pairs]
        information = np.diag(np.square(by))
    else:
        nominal, information, noise, fitted_sizes = _earlier(problem, Path(after))
        sizes |= {key: size for key, size in fitted_sizes.items() if key in sizes}
    width = widths(problem)
    values, vectors = np.linalg.eigh(information * np.outer(width, width))
    informed = values > _WEAK
    spread = np.minimum(1.0 / np.sqrt(values[informed]), _WIDEST)
    unknowns = problem.unknowns(nominal)
    drawn = unknowns[None]
    if informed.any():
        sampler = qmc.Sobol(int(informed.sum()), scramble=True, seed=_SEED)
        normal = norm.ppf(sampler.random(_DRAWS))[1:]
        shifts = width * ((normal * spread) @ vectors[:, informed].T)
        drawn = np.concatenate([drawn, unknowns + shifts])
    draws = np.array([problem.values(row) for row in reflected(drawn, *problem.unknown_bounds)])
    draws[0] = nominal
    return PriorInformation(
        nominal, information, draws, str(after or ""),
        bool((values > _UNINFORMED).all()), noise,
        np.array([sum(size**2 for (k, _), size in sizes.items() if k == key)
                  for key in problem.keys], dtype=float),
    )  # fmt: skip


def with_noise(problem: Problem, prior: PriorInformation) -> Problem:
    """Return a problem with the noise that an earlier fit has found, where it is to be fitted.

    It is that of the same series of the same experiment; else of the same one of the first
    experiment that had it.
    """

    def renoised(experiment: Experiment, series: Series) -> Series:
        of_series = [noise for (_, name), noise in prior.noise.items() if name == series.name]
        noise = prior.noise.get((experiment.name, series.name), of_series[0] if of_series else None)
        if not series.sd_fitted or noise is None:
            return series
        try:
            scale = factor(noise[1], series.unit)
        except RejectedError:
            return series
        return replace(series, sd=np.full(series.n, noise[0] * scale * series.factor))

    experiments = tuple(
        replace(
            experiment, series=tuple(renoised(experiment, series) for series in experiment.series)
        )
        for experiment in problem.experiments
    )
    return replace(problem, experiments=experiments)


def _expected(parameter: FittedParameter) -> float:
    """Return the mean of a prior, or the start where there is none."""
    if parameter.prior is None:
        return parameter.start
    low, high = parameter.bounds
    return min(max(parameter.prior.mean, low), high)


def _earlier(
    problem: Problem, folder: Path
) -> tuple[
    FloatArray,
    FloatArray,
    dict[tuple[str, str], tuple[float, str]],
    dict[tuple[str, str], float],
]:
    """Return estimates, information of the unknowns, fitted noise and scatters of a fit."""
    path, keys = folder / "fit.json", list(problem.keys)
    try:
        text = read_text(path)
    except InputError as error:
        raise InputError(f"--after {error}; {_ALLOWED}") from error
    try:
        outcome = json.loads(text)
        earlier_keys, estimates, logs = outcome["keys"], outcome["parameters"], outcome["log"]
        nominal = np.array([estimates[key]["estimate"] for key in earlier_keys], dtype=float)
        information = np.array(outcome["information"], dtype=float).reshape(
            len(earlier_keys), len(earlier_keys)
        )
        noise = {
            (experiment, name): (float(entry["sd"]), str(entry["unit"]))
            for experiment, series in outcome["experiments"].items()
            for name, entry in series.items()
            if "sd" in entry
        }
        sizes = {
            (key, group): float(scatter["known" if "known" in scatter else "estimate"])
            for key, estimate in estimates.items()
            for group, scatter in estimate.get("scatter", {}).items()
        }
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"--after {path}: is no outcome of ringwear fit; {_ALLOWED}") from error
    if sorted(earlier_keys) != sorted(keys):
        raise InputError(
            f"{path}: keys = {shortened(earlier_keys)}: must be those of {problem.name}, "
            f"{', '.join(keys)}"
        )
    order = [earlier_keys.index(key) for key in keys]
    nominal, information = nominal[order], information[np.ix_(order, order)]
    # a scale may be logarithmic in the one and linear in the other
    changes = []
    for parameter, value, log in zip(
        problem.parameters, nominal.tolist(), [logs[i] for i in order], strict=True
    ):
        low, high = parameter.bounds
        if not low <= value <= high:
            raise InputError(
                f"{path}: {parameter.key} = {value:g}: must be within the bounds of "
                f"{problem.name}, {low:g} to {high:g}"
            )
        changes.append(parameter.slope(value) / (value if log else 1.0))
    return nominal, information * np.outer(changes, changes), noise, sizes


def information_of_tests(
    problem: Problem,
    tests: Sequence[Experiment],
    draws: FloatArray,
    scatter: FloatArray,
    comm: MPI.Intracomm,
) -> tuple[FloatArray, dict[int, str], int]:
    """Return the information (d, tests, m, m) of each test on unknowns, at draws (d, m) of values.

    Then why histories fail, by number of the test, which has NaN then, and how many were computed.
    Tests of one case, the same object, share its histories; series that they share are read once.
    Each test is of a new specimen, whose unknowns scatter by variances (m,). Collective on comm;
    its ranks share each draw.
    """
    groups: dict[int, list[int]] = {}
    for number, test in enumerate(tests):
        groups.setdefault(id(test.case), []).append(number)
    numbers = list(groups.values())
    whole = []
    for group in numbers:  # the test that has all series of those of one case
        series = {id(record): record for number in group for record in tests[number].series}
        whole.append(replace(tests[group[0]], series=tuple(series.values())))
    settings = replace(problem.settings, process={})  # not counted: series share a clock
    union_problem = replace(problem, experiments=tuple(whole), alternatives={}, settings=settings)
    # signals are not waited for: there is nothing to keep
    rounds = Rounds(union_problem, comm, StopSignals())

    def compute() -> tuple[FloatArray, dict[int, str], int]:
        m = len(problem.parameters)
        matrices = np.full((len(draws), len(tests), m, m), np.nan)
        failures: dict[int, str] = {}
        for d, values in enumerate(draws):
            slopes = problem.slopes(values.tolist())
            responses = rounds.read(values[None], [(0, test) for test in range(len(whole))])
            for group, test, response in zip(numbers, whole, responses, strict=True):
                if isinstance(response, Exception):
                    failures |= {n: str(response) for n in group if n not in failures}
                    continue
                by_series = _series_information(problem, test, response[:, 1 : 1 + m] * slopes)
                for number in group:
                    test_information = sum(by_series[id(series)] for series in tests[number].series)
                    matrices[d, number] = of_new_specimen(np.asarray(test_information), scatter)
        return matrices, failures, rounds.count

    return rounds.lead(compute)


def _series_information(
    problem: Problem, test: Experiment, columns: FloatArray
) -> dict[int, FloatArray]:
    """Return the information (m, m) of each series of a test."""
    ends = np.cumsum([series.n for series in test.series])
    return {
        id(series): information(problem, test.case, series, columns[end - series.n : end])
        for series, end in zip(test.series, ends.tolist(), strict=True)
    }


def information(problem: Problem, case: Case, series: Series, columns: FloatArray) -> FloatArray:
    """Return the information (m, m) of a series by derivatives (n, m), its nuisances eliminated.

    As nuisances are of one series, what several tell adds.
    """
    m = columns.shape[1]
    columns_and_nuisances = np.concatenate([columns, nuisance_columns(series, case)], axis=1)
    weighted = np.sqrt(information_share(problem.settings.loss)) * whitened(
        series, columns_and_nuisances / series.sd[:, None]
    )
    priors = [0.0 if n.prior is None else 1.0 / n.prior.sd for n in series.nuisances]
    stacked = np.concatenate([weighted, np.diag([*[0.0] * m, *priors])])
    reduced = NuisanceProjection(stacked[:, m:]).rest(stacked[:, :m])
    return reduced.T @ reduced
