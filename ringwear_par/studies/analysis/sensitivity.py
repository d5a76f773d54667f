"""Sensitivity indices: how final values depend on the varied keys, by SALib.

Of the surrogate where it is good: first-order and total Sobol' indices, which a sample does not
tell. Or else of a sampled design itself: first-order ones and the moment-independent delta.
"""

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

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import InputError
from ringwear_par.studies.analysis.regression import Part
from ringwear_par.studies.analysis.responses import SEED, chosen_cases, done_cases
from ringwear_par.studies.analysis.surrogate import COARSE, Surrogate, share_words, surrogate
from ringwear_par.studies.definition.designs import SAMPLED
from ringwear_par.studies.end_values import figure_columns, final_name
from ringwear_par.studies.ensemble import Ensemble

log = logging.getLogger(__name__)

#: fewest and most cases, and resamples for 95 % confidence
_FEWEST, _MOST, RESAMPLES = 100, 4000, 100
#: fewest cases that must differ from the others, in so many digits
_FEWEST_DIFFERING, _DIGITS = 20, 12
#: about how many evaluations of a surrogate
EVALUATIONS = 1e6
_FIRST = "first order S\N{SUBSCRIPT ONE}"
_NO_SALIB = (
    "no sensitivity indices: SALib is not installed; "
    'pip install "ringwear-par[sensitivity]" installs it'
)


@dataclass(frozen=True)
class Indices:
    """Two sensitivity indices of one output by key."""

    #: name of a final value
    output: str
    #: the varied keys that are numbers
    keys: tuple[str, ...]
    #: what the indices are of
    source: str
    #: of both indices
    names: tuple[str, str]
    #: first-order indices, (keys,)
    first: FloatArray
    #: how much each key matters, (keys,): total Sobol' indices, or delta
    influence: FloatArray
    #: half-widths of their 95 % confidence intervals, None where errors are not of sampling
    first_width: FloatArray | None = None
    influence_width: FloatArray | None = None
    #: what ``influence`` comes to, by sampling, for a key that does not matter, its confidence
    #: included
    noise: float = 0.0


def sensitivity_indices(ensemble: Ensemble, regressions: Surrogate | None) -> tuple[Indices, ...]:
    """Return the indices of outputs: of the surrogate where it is good, or else of the sample."""
    outputs = figure_columns(ensemble.final, done_cases(ensemble))
    indices: dict[str, Indices] = {}
    if regressions is not None and len(regressions.parts[0].keys) > 1:
        part = regressions.parts[0]
        errors = {n: part.responses[n].relative_error for n in outputs if n in part.responses}
        good = [name for name, error in errors.items() if 0.0 < error <= COARSE]
        indices = {entry.output: entry for entry in surrogate_indices(part, good)}
    rest = [name for name in outputs if name not in indices]
    indices |= {entry.output: entry for entry in sample_indices(ensemble, rest)}
    return tuple(indices[name] for name in outputs if name in indices)


def sample_indices(ensemble: Ensemble, outputs: Sequence[str]) -> tuple[Indices, ...]:
    """Return first-order and delta indices of outputs that vary, from a sampled design's cases.

    None where the design is no sample, and, with a sentence in the log, where SALib is not
    installed or too few cases are done. The method needs no design of its own: E. Plischke, E.
    Borgonovo and C. L. Smith, "Global sensitivity measures from given data", European Journal of
    Operational Research 226 (2013), 536-550. Its confidence is that of resampling; beside it, delta
    comes out up to about 0.1 too low for a key that matters, and above 0 for one that does not.
    Always the same for the same results. Not collective.
    """
    if ensemble.attributes.get("method") not in SAMPLED:
        return ()
    done = done_cases(ensemble)
    columns = {
        name: values
        for name, values in ensemble.varied.items()
        if values.dtype.kind == "f" and len(np.unique(values[done & np.isfinite(values)])) > 1
    }
    if not columns:
        return ()
    x = np.stack([*columns.values()], axis=1)
    known = done & np.isfinite(x).all(axis=1)
    indices = []
    for output in outputs:
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
        # one key more, which has nothing to do with the output
        irrelevant = np.random.default_rng(SEED).random(len(chosen))
        try:
            estimates = _delta(np.column_stack([x[chosen], irrelevant]), y[chosen])
        except ImportError:
            log.warning(_NO_SALIB)
            return ()
        delta, delta_width, first, first_width = (index[:-1] for index in estimates)
        part_of = f"{len(chosen)} of {len(cases)}" if len(chosen) < len(cases) else str(len(cases))
        indices.append(
            Indices(
                output, tuple(columns), f"sample of {part_of} cases,\n95 % confidence",
                (_FIRST, "\N{GREEK SMALL LETTER DELTA}, of the whole distribution"),
                first, delta, first_width, delta_width, float(estimates[0][-1] + estimates[1][-1]),
            )
        )  # fmt: skip
    return tuple(indices)


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
        options = {"num_resamples": RESAMPLES, "seed": SEED}
        try:
            delta = salib.analyze(problem, x, scores, method="delta", **options)
            first = salib.analyze(problem, x, (y - y.mean()) / y.std(), method="sobol", **options)
        finally:
            salib.np = its_numpy
    name = "delta" if "delta" in delta else "delta_raw"  # which it is called from SALib 1.6 on
    return delta[name], delta[f"{name}_conf"], first["S1"], first["S1_conf"]


def _rounded(y: FloatArray) -> FloatArray:
    """Return an output relative to its largest value, without rounding errors."""
    largest = float(np.abs(y).max())
    return np.round(y / (largest or 1.0), _DIGITS)


def _differing(y: FloatArray) -> int:
    """Return the number of cases whose output is not the most frequent one."""
    return len(y) - int(np.unique(_rounded(y), return_counts=True)[1].max())


@contextmanager
def _untouched() -> Iterator[None]:
    """Undo what SALib does to warnings, and to the seed of numpy's own generator."""
    state, format_of_warnings = np.random.get_state(), warnings.formatwarning
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            yield
        finally:
            warnings.formatwarning = format_of_warnings
            np.random.set_state(state)


def surrogate_indices(part: Part, names: Sequence[str]) -> tuple[Indices, ...]:
    """Return Sobol' indices of responses of a surrogate that are numbers and vary.

    From about a million evaluations: the error of sampling is below 0.01, that of the surrogate is
    its own leave-out error. Keys vary evenly, or their logarithms where they go by them, and
    independently of each other, whatever the design was. None, with a sentence in the log, where
    SALib is not installed. Not collective.
    """
    if not names:
        return ()
    # pandas 3 takes no lists of names from SALib 1.5
    problem: dict[str, Any] = {
        "num_vars": len(part.keys), "names": np.array([f"x{i}" for i in range(len(part.keys))]),
        "bounds": [[0.0, 1.0]] * len(part.keys),
    }  # fmt: skip
    base = 2 ** round(math.log2(EVALUATIONS / (len(part.keys) + 2)))
    indices = []
    with _untouched():
        try:
            from SALib.analyze import sobol
            from SALib.sample import sobol as sampling
        except ImportError:
            log.info(_NO_SALIB)  # the indices of a sample warn
            return ()
        points = sampling.sample(problem, base, calc_second_order=False, seed=SEED)
        for name, values in part.at(points, names).items():
            answer = sobol.analyze(  # it would give the confidence of sampling from resamples
                problem, values[:, 0], calc_second_order=False, num_resamples=2, seed=SEED
            )
            source = (
                f"surrogate of {len(part.points)} cases,\n"
                f"leave-out error {share_words(part.responses[name].relative_error)}"
            )
            words = _FIRST, "total S\N{LATIN SUBSCRIPT SMALL LETTER T}"
            indices.append(Indices(name, part.keys, source, words, answer["S1"], answer["ST"]))
    return tuple(indices)


def surrogate_and_indices(
    ensemble: Ensemble,
) -> tuple[Surrogate | None, tuple[Indices, ...], str]:
    """Return the surrogate of a sweep, its indices, and why there is no surrogate, "" for one.

    Not collective.
    """
    try:
        regressions = surrogate(ensemble)
    except InputError as error:
        return None, sensitivity_indices(ensemble, None), str(error)
    return regressions, sensitivity_indices(ensemble, regressions), ""
