"""Choice of what is drawn of a sweep: cases, final values, and the keys of the largest indices."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import IntArray
from ringwear_par.errors import InputError
from ringwear_par.studies.analysis.effects import Key, Plan, key_of, plan_of
from ringwear_par.studies.analysis.predictions import Surrogate
from ringwear_par.studies.analysis.sensitivity import done_cases, outputs_of
from ringwear_par.studies.pictures.index_bars import IndexBars, most_important
from ringwear_par.studies.pictures.surrogate_figures import Responses
from ringwear_par.studies.storage.ensemble import Ensemble

#: keys that are drawn: with more of them the figure is of no use
_MOST_KEYS = 8


@dataclass(frozen=True)
class Choice:
    """What is drawn of a sweep.

    Parameters
    ----------
    cases : numbers of those that are done.
    outputs : names of final values.
    keys, plans : the varied keys of the largest indices, and how outputs are drawn against each.
    responses : what the surrogate tells of them; None: nothing, or there is none.
    told : how many cases and keys, in words.
    """

    cases: IntArray
    outputs: list[str]
    keys: list[Key]
    plans: list[Plan]
    responses: Responses | None
    told: str


def choose(ensemble: Ensemble, regressions: Surrogate | None, bars: Sequence[IndexBars]) -> Choice:
    """Choose what is drawn of a sweep. Not collective.

    Raises
    ------
    InputError : no case is done.
    """
    drawn = done(ensemble)
    outputs = outputs_of(ensemble, drawn)
    varied = [
        key_of(name, values[drawn], ensemble.spacings.get(name, (None,))[0])
        for name, values in ensemble.varied.items()
    ]
    varied = [key for key in varied if key.differs] or varied
    names = most_important([key.name for key in varied], bars, _MOST_KEYS)
    keys = [key for key in varied if key.name in names]
    responses = None if regressions is None else Responses.of(regressions, outputs, names)
    method = str(ensemble.attributes.get("method"))
    plans = [plan_of(key, [other for other in varied if other is not key], method) for key in keys]
    told = _counts(ensemble)
    if len(keys) < len(varied):
        why = "of the largest indices" if bars else "the first"
        told += f"; {len(keys)} of {len(varied)} keys, {why}"
    return Choice(drawn, outputs, keys, plans, responses, told)


def done(ensemble: Ensemble) -> IntArray:
    """Return the numbers of the cases that are done, which are drawn.

    Raises
    ------
    InputError : there is none.
    """
    drawn = np.flatnonzero(done_cases(ensemble))
    if not len(drawn):
        raise InputError(
            f"{ensemble.path}: has no case that is done ({_counts(ensemble)}); must have one at "
            "least"
        )
    return drawn


def _counts(ensemble: Ensemble) -> str:
    """Say how many cases there are, and how many of them are not drawn."""
    status = np.array(ensemble.status)[ensemble.in_study]
    said = [f"{len(status)} case{'s' if len(status) != 1 else ''}"]
    for word in ("failed", "incomplete"):
        count = int((status == word).sum())
        if count:
            said.append(f"{count} {word}")
    return ", ".join(said)
