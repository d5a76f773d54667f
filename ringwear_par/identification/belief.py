"""What is known of the fitted keys before tests are made: priors, or an earlier fit."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import norm, qmc

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.text import shortened
from ringwear_par.errors import InputError
from ringwear_par.identification.problem import FittedParameter, Problem, reflected
from ringwear_par.textfiles import read_text

#: draws of the keys, and their seed
_DRAWS, _SEED = 8, 0
#: information over the widths of bounds: below the one nothing is known of a direction, below the
#: other it is not drawn along; most standard deviations that are, over these widths
_NOTHING, _HARDLY, _WIDEST = 1e-6, 1.0, 0.25


@dataclass(frozen=True, eq=False)
class Belief:
    """What is known of the keys.

    Parameters
    ----------
    nominal : (m,) values.
    information : (m, m) of the unknowns.
    draws : (d, m) values, the nominal ones first.
    after : the earlier fit, "" for none.
    whole : whether something is known in every direction.
    """

    nominal: FloatArray
    information: FloatArray
    draws: FloatArray
    after: str
    whole: bool


def widths(parameters: tuple[FittedParameter, ...]) -> FloatArray:
    """Return (m,) between the bounds of the unknowns."""
    return np.array([p.unknown(p.bounds[1]) - p.unknown(p.bounds[0]) for p in parameters])


def belief(problem: Problem, after: str | Path | None) -> Belief:
    """Return what priors or an earlier fit tell.

    Raises
    ------
    InputError : the earlier fit is none of these keys.
    """
    parameters = problem.parameters
    if after is None:
        nominal = np.array([_expected(p) for p in parameters])
        pairs = zip(parameters, nominal.tolist(), strict=True)
        by = [0.0 if p.prior is None else p.slope(v) / p.prior.sd for p, v in pairs]
        information = np.diag(np.square(by))
    else:
        nominal, information = _earlier(problem, Path(after))
    wide = widths(parameters)
    values, vectors = np.linalg.eigh(information * np.outer(wide, wide))
    told = values > _HARDLY
    spread = np.minimum(1.0 / np.sqrt(values[told]), _WIDEST)
    unknowns = np.array([p.unknown(v) for p, v in zip(parameters, nominal, strict=True)])
    drawn = unknowns[None]
    if told.any():
        sampler = qmc.Sobol(int(told.sum()), scramble=True, seed=_SEED)
        normal = norm.ppf(sampler.random(_DRAWS))[1:]
        shifts = wide * ((normal * spread) @ vectors[:, told].T)
        drawn = np.concatenate([drawn, unknowns + shifts])
    low, high = np.array([[p.unknown(b) for b in p.bounds] for p in parameters]).T
    drawn = reflected(drawn, low, high)
    values_of = [[p.value(float(u)) for p, u in zip(parameters, row, strict=True)] for row in drawn]
    values_of[0] = nominal.tolist()
    return Belief(
        nominal, information, np.array(values_of), str(after or ""), bool((values > _NOTHING).all())
    )


def _expected(parameter: FittedParameter) -> float:
    """Return the mean of a prior, or the start where there is none."""
    if parameter.prior is None:
        return parameter.start
    low, high = parameter.bounds
    return min(max(parameter.prior.mean, low), high)


def _earlier(problem: Problem, folder: Path) -> tuple[FloatArray, FloatArray]:
    """Return estimates and their information (of the unknowns) from an earlier fit."""
    path, keys = folder / "fit.json", list(problem.keys)
    text = read_text(path)
    try:
        told = json.loads(text)
        there, own, logs = told["keys"], told["parameters"], told["log"]
        nominal = np.array([own[key]["estimate"] for key in there], dtype=float)
        information = np.array(told["information"], dtype=float).reshape(len(there), len(there))
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: is no outcome of ringwear fit") from error
    if sorted(there) != sorted(keys):
        raise InputError(
            f"{path}: keys = {shortened(there)}: must be those of {problem.name}, {', '.join(keys)}"
        )
    order = [there.index(key) for key in keys]
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
    return nominal, information * np.outer(changes, changes)
