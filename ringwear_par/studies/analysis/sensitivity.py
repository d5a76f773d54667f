"""Sensitivity indices of a sampled design: how final values depend on the varied keys."""

import logging
import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.special import ndtri
from scipy.stats import rankdata

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.studies.analysis.regression import SEED, Part
from ringwear_par.studies.definition.designs import SAMPLED
from ringwear_par.studies.storage.end_values import figure_columns, final_name
from ringwear_par.studies.storage.ensemble import Ensemble

log = logging.getLogger(__name__)

#: fewest and most cases, 95 % confidence from so many resamples
_FEWEST, _MOST, _RESAMPLES = 100, 4000, 100
#: so many cases differ from the others at least, in so many digits
_FEWEST_DIFFERING, _DIGITS = 20, 12
#: of a surrogate, about
_EVALUATIONS = 1e6
_NO_SALIB = (
    "no sensitivity indices: SALib is not installed; "
    'pip install "ringwear-par[sensitivity]" installs it'
)


@dataclass(frozen=True)
class Sensitivity:
    """Sensitivity indices of one output, with the half-widths of their 95 % confidence intervals.

    Parameters
    ----------
    output : name of a final value.
    keys : the varied keys that are numbers.
    used, cases : number of cases that the indices follow from, of so many that are done.
    delta, delta_conf : moment-independent index, (keys,).
    s1, s1_conf : first-order index, (keys,).
    delta_noise : what delta comes to for a key that does not matter, its confidence included.
    """

    output: str
    keys: tuple[str, ...]
    used: int
    cases: int
    delta: FloatArray
    delta_conf: FloatArray
    s1: FloatArray
    s1_conf: FloatArray
    delta_noise: float


def sensitivity(
    ensemble: Ensemble, outputs: Sequence[str] | None = None
) -> tuple[Sensitivity, ...]:
    """Return how the final values depend on the varied keys, from the cases of a sampled design.

    One item an output that varies. None where the design is no sample, and, with a sentence in the
    log, where SALib is not installed or too few cases are done. The method needs no design of its
    own: E. Plischke, E. Borgonovo and C. L. Smith, "Global sensitivity measures from given data",
    European Journal of Operational Research 226 (2013), 536-550. Its confidence is that of
    resampling; beside it, delta comes out up to about 0.1 too low for a key that matters, and
    above 0 for one that does not. Outputs are those of ``outputs_of``, unless said. Always the same
    for the same results. Not collective.
    """
    if ensemble.attributes.get("method") not in SAMPLED:
        return ()
    done = done_cases(ensemble)
    names, columns = [], []
    for name, values in ensemble.varied.items():
        if values.dtype.kind == "f" and len(np.unique(values[done & np.isfinite(values)])) > 1:
            names.append(name)
            columns.append(values)
    if not names:
        return ()
    x = np.stack(columns, axis=1)
    known = done & np.isfinite(x).all(axis=1)
    found = []
    for output in outputs_of(ensemble, done) if outputs is None else outputs:
        y = ensemble.final[output]
        cases = np.flatnonzero(known & np.isfinite(y))
        if len(cases) < _FEWEST:
            log.info(
                "no sensitivity indices of the %s: %d cases are done, at least %d are needed",
                final_name(output), len(cases), _FEWEST,
            )  # fmt: skip
            continue
        if _differing(y[cases]) < _FEWEST_DIFFERING:
            log.info(
                "no sensitivity indices of the %s: it is the same in all cases, or in nearly all",
                final_name(output),
            )
            continue
        chosen = chosen_cases(cases, _MOST)
        try:
            # one key more, which has nothing to do with the output
            nothing = np.random.default_rng(SEED).random(len(chosen))
            indices = _delta(np.column_stack([x[chosen], nothing]), y[chosen])
        except ImportError:
            log.warning(_NO_SALIB)
            return ()
        noise = float(indices[0][-1] + indices[1][-1])
        delta, delta_conf, s1, s1_conf = (index[:-1] for index in indices)
        found.append(
            Sensitivity(
                output, tuple(names), len(chosen), len(cases), delta, delta_conf, s1, s1_conf, noise
            )
        )
    return tuple(found)


def outputs_of(ensemble: Ensemble, cases: BoolArray | IntArray) -> list[str]:
    """Return the outputs of some cases, see ``drawn``."""
    return figure_columns(ensemble.final, cases)


def _delta(x: FloatArray, y: FloatArray) -> tuple[FloatArray, ...]:
    """Return delta, its confidence, S1 and its confidence, by SALib.

    Delta does not change with a monotone function of the output, but SALib's densities on 100
    points do, and fail for an output that spans decades: it is given normal scores of the ranks.
    """
    scores = ndtri((rankdata(_rounded(y)) - 0.5) / len(y))
    # SALib refuses some names
    problem = {"num_vars": x.shape[1], "names": [f"x{i}" for i in range(x.shape[1])]}
    with _untouched():
        import SALib.analyze.delta as salib

        its_numpy = salib.np
        if not hasattr(np, "trapezoid"):  # SALib 1.5 calls trapz by the name that numpy 2 gave it
            salib.np = SimpleNamespace(**{**vars(np), "trapezoid": vars(np)["trapz"]})
        options = {"num_resamples": _RESAMPLES, "seed": SEED}
        try:
            delta = salib.analyze(problem, x, scores, method="delta", **options)
            first = salib.analyze(problem, x, (y - y.mean()) / y.std(), method="sobol", **options)
        finally:
            salib.np = its_numpy
    name = "delta" if "delta" in delta else "delta_raw"  # which it is called from SALib 1.6 on
    return delta[name], delta[f"{name}_conf"], first["S1"], first["S1_conf"]


@contextmanager
def _untouched() -> Iterator[None]:
    """Keep from others what SALib does to warnings, and to the seed of numpy's own generator."""
    state, format_of_warnings = np.random.get_state(), warnings.formatwarning
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            yield
        finally:
            warnings.formatwarning = format_of_warnings
            np.random.set_state(state)


@dataclass(frozen=True)
class SobolIndices:
    """Sobol' indices of one response of a surrogate; its keys vary evenly over their ranges.

    Parameters
    ----------
    output : name of the response.
    keys : the varied keys that are numbers.
    evaluations : of the surrogate.
    first, total : (keys,).
    """

    output: str
    keys: tuple[str, ...]
    evaluations: int
    first: FloatArray
    total: FloatArray


def sobol_indices(part: Part, names: Sequence[str]) -> tuple[SobolIndices, ...]:
    """Return Sobol' indices of responses of a surrogate that are numbers and vary.

    By SALib, from about a million evaluations: the error of sampling is below 0.01, that of the
    surrogate is its own leave-out error. Keys vary evenly, or their logarithms where they go by
    them, and independently of each other, whatever the design was. None, with a sentence in the
    log, where SALib is not installed. Not collective.
    """
    # pandas 3 takes no lists of names from SALib 1.5
    problem: dict[str, Any] = {
        "num_vars": len(part.keys), "names": np.array([f"x{i}" for i in range(len(part.keys))]),
        "bounds": [[0.0, 1.0]] * len(part.keys),
    }  # fmt: skip
    base = 2 ** round(math.log2(_EVALUATIONS / (len(part.keys) + 2)))
    found = []
    with _untouched():
        try:
            from SALib.analyze import sobol
            from SALib.sample import sobol as sampling
        except ImportError:
            log.info(_NO_SALIB)  # the indices of a sample warn
            return ()
        points = sampling.sample(problem, base, calc_second_order=False, seed=SEED)
        for name, values in part.at(points, names).items():
            indices = sobol.analyze(  # it would give the confidence of sampling from resamples
                problem, values[:, 0], calc_second_order=False, num_resamples=2, seed=SEED
            )
            found.append(SobolIndices(name, part.keys, len(points), indices["S1"], indices["ST"]))
    return tuple(found)


def _rounded(y: FloatArray) -> FloatArray:
    """Return an output relative to its largest value, without rounding errors."""
    largest = float(np.abs(y).max())
    rounded: FloatArray = np.round(y / (largest or 1.0), _DIGITS)
    return rounded


def _differing(y: FloatArray) -> int:
    """Return the number of cases whose output is not the most frequent one."""
    return len(y) - int(np.unique(_rounded(y), return_counts=True)[1].max())


def done_cases(ensemble: Ensemble) -> BoolArray:
    """Return whether each case is of the study and done."""
    return ensemble.in_study & (np.array(ensemble.status) == "done")


def chosen_cases(cases: IntArray, most: int) -> IntArray:
    """Return the cases, or so many of them, increasing."""
    if len(cases) <= most:
        return cases
    return np.sort(np.random.default_rng(SEED).choice(cases, most, replace=False))
