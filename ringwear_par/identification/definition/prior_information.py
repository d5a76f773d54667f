"""What is known of the fitted keys before tests are made: priors, or an earlier fit."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import norm, qmc

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.text import shortened
from ringwear_par.cases.units import factor
from ringwear_par.cases.values import RejectedError
from ringwear_par.errors import InputError
from ringwear_par.files.text import parse_json, read_text
from ringwear_par.identification.definition.problem import (
    Experiment,
    FittedParameter,
    Problem,
    Series,
    reflected,
)

#: draws of the keys, and their seed
_DRAWS, _SEED = 8, 0
#: information over the widths of bounds: below the one nothing is known of a direction, below the
#: other it is not drawn along; most standard deviations that are, over these widths
_UNINFORMED, _WEAK, _WIDEST = 1e-6, 1.0, 0.25
_ALLOWED = "must be the folder of a fit of the same keys that is done (ringwear fit -o)"


@dataclass(frozen=True, eq=False)
class PriorInformation:
    """Values of the keys before tests are made, and how well they are known.

    Parameters
    ----------
    nominal : (m,) values.
    information : (m, m) of the unknowns.
    draws : (d, m) values, the nominal ones first.
    after : the earlier fit, "" for none.
    whole : whether something is known in every direction.
    noise : sd that an earlier fit has found, in the data's unit, and that unit: by experiment and
        series.
    """

    nominal: FloatArray
    information: FloatArray
    draws: FloatArray
    after: str
    whole: bool
    noise: Mapping[tuple[str, str], tuple[float, str]]


def widths(parameters: tuple[FittedParameter, ...]) -> FloatArray:
    """Return (m,) between the bounds of the unknowns."""
    return np.array([p.unknown(p.bounds[1]) - p.unknown(p.bounds[0]) for p in parameters])


def prior_information(problem: Problem, after: str | Path | None) -> PriorInformation:
    """Return the information of priors or of an earlier fit.

    Raises
    ------
    InputError : the earlier fit is none of these keys.
    """
    parameters = problem.parameters
    noise: dict[tuple[str, str], tuple[float, str]] = {}
    if after is None:
        nominal = np.array([_expected(p) for p in parameters])
        pairs = zip(parameters, nominal.tolist(), strict=True)
        by = [0.0 if p.prior is None else p.slope(v) / p.prior.sd for p, v in pairs]
        information = np.diag(np.square(by))
    else:
        nominal, information, noise = _earlier(problem, Path(after))
    width = widths(parameters)
    values, vectors = np.linalg.eigh(information * np.outer(width, width))
    informed = values > _WEAK
    spread = np.minimum(1.0 / np.sqrt(values[informed]), _WIDEST)
    unknowns = np.array([p.unknown(v) for p, v in zip(parameters, nominal, strict=True)])
    drawn = unknowns[None]
    if informed.any():
        sampler = qmc.Sobol(int(informed.sum()), scramble=True, seed=_SEED)
        normal = norm.ppf(sampler.random(_DRAWS))[1:]
        shifts = width * ((normal * spread) @ vectors[:, informed].T)
        drawn = np.concatenate([drawn, unknowns + shifts])
    low, high = np.array([[p.unknown(b) for b in p.bounds] for p in parameters]).T
    drawn = reflected(drawn, low, high)
    values_of = [[p.value(float(u)) for p, u in zip(parameters, row, strict=True)] for row in drawn]
    values_of[0] = nominal.tolist()
    return PriorInformation(
        nominal, information, np.array(values_of), str(after or ""),
        bool((values > _UNINFORMED).all()), noise,
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
        replace(one, series=tuple(renoised(one, series) for series in one.series))
        for one in problem.experiments
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
) -> tuple[FloatArray, FloatArray, dict[tuple[str, str], tuple[float, str]]]:
    """Return estimates, their information (of the unknowns) and fitted noise of an earlier fit."""
    path, keys = folder / "fit.json", list(problem.keys)
    try:
        text = read_text(path)
    except InputError as error:
        raise InputError(f"--after {error}; {_ALLOWED}") from error
    try:
        outcome = parse_json(text)
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
    return nominal, information * np.outer(changes, changes), noise
