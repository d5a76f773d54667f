"""Sensitivity indices of a sweep, drawn: those of its surrogate, or else of the sample itself."""

from collections.abc import Sequence
from dataclasses import dataclass

from ringwear_par.arrays import FloatArray
from ringwear_par.studies.analysis.predictions import COARSE, Surrogate, told_share
from ringwear_par.studies.analysis.sensitivity import (
    done_cases,
    outputs_of,
    sensitivity,
    sobol_indices,
)
from ringwear_par.studies.storage.ensemble import Ensemble

_FIRST = "first order S\N{SUBSCRIPT ONE}"


@dataclass(frozen=True)
class IndexBars:
    """Two indices of one output by key.

    Parameters
    ----------
    output : name of the output.
    keys : the varied keys that are numbers.
    source : what the indices are of.
    names, values : of both indices, (keys,) each; the second one tells more of how much a key
        matters.
    widths : half-widths of their 95 % confidence intervals, None where errors are not of sampling.
    noise : what the second index comes to, by sampling, for a key that does not matter.
    """

    output: str
    keys: tuple[str, ...]
    source: str
    names: tuple[str, str]
    values: tuple[FloatArray, FloatArray]
    widths: tuple[FloatArray | None, FloatArray | None] = (None, None)
    noise: float = 0.0


def index_bars(ensemble: Ensemble, regressions: Surrogate | None) -> tuple[IndexBars, ...]:
    """Return indices of outputs: of the surrogate where it is good, or else of a sampled design.

    First-order and total Sobol' indices, which a sample does not tell; beside its first-order ones
    it has the moment-independent delta, see ``sensitivity``.
    """
    found: dict[str, IndexBars] = {}
    outputs = outputs_of(ensemble, done_cases(ensemble))
    if regressions is not None and len(regressions.parts[0].keys) > 1:
        part = regressions.parts[0]
        there = [name for name in outputs if name in part.responses]
        errors = {name: part.responses[name].relative_error for name in there}
        good = [name for name, error in errors.items() if 0.0 < error <= COARSE]
        for each in sobol_indices(part, good) if good else ():
            found[each.output] = IndexBars(
                each.output, each.keys,
                f"surrogate of {len(part.points)} cases,\n"
                f"leave-out error {told_share(errors[each.output])}",
                (_FIRST, "total S\N{LATIN SUBSCRIPT SMALL LETTER T}"), (each.first, each.total),
            )  # fmt: skip
    rest = [name for name in outputs if name not in found]
    for own in sensitivity(ensemble, rest) if rest else ():
        part_of = f"{own.used} of {own.cases}" if own.used < own.cases else str(own.cases)
        found[own.output] = IndexBars(
            own.output, own.keys, f"sample of {part_of} cases,\n95 % confidence",
            (_FIRST, "\N{GREEK SMALL LETTER DELTA}, of the whole distribution"),
            (own.s1, own.delta), (own.s1_conf, own.delta_conf), own.delta_noise,
        )  # fmt: skip
    return tuple(found[name] for name in outputs if name in found)


def most_important(keys: Sequence[str], bars: Sequence[IndexBars], most: int) -> list[str]:
    """Return so many keys of the largest indices, in their order; without indices the first."""
    weights = dict.fromkeys(keys, 2.0 if bars else 0.0)  # of texts, which have none
    for number, each in enumerate(bars):
        for key, value in zip(each.keys, each.values[1].tolist(), strict=True):
            if key in weights:
                weights[key] = max(value, weights[key] if number else value)
    chosen = sorted(keys, key=lambda key: -weights[key])[:most]
    return [key for key in keys if key in chosen]
