"""Cases of a sweep that are analysed, and their responses to the varied keys, as stored."""

import math
from collections.abc import Iterator

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.errors import InputError
from ringwear_par.results.variables import LAYER_HISTORIES
from ringwear_par.studies.end_values import MAIN_END_VALUES, end_value_of, entries
from ringwear_par.studies.ensemble import Ensemble
from ringwear_par.studies.stored_variables import AT_STATES

#: seed of all random choices: the same results give the same figure
SEED = 1
#: profiles of wear, and their largest values
DEPTHS = ("wear_lower", "wear_upper")
LARGEST = tuple(f"largest_{name}" for name in DEPTHS)
#: stored states whose profiles are read together
_STATES = 4000


def done_cases(ensemble: Ensemble) -> BoolArray:
    """Return whether each case is done."""
    return np.array(ensemble.status) == "done"


def chosen_cases(cases: IntArray, most: int) -> IntArray:
    """Return the cases, or so many of them chosen at random, increasing."""
    if len(cases) <= most:
        return cases
    return np.sort(np.random.default_rng(SEED).choice(cases, most, replace=False))


def upper_limit(name: str) -> float:
    """Return the value that a response cannot be above: shares are at most all."""
    return 1.0 if name in LAYER_HISTORIES else math.inf


def read_responses(
    ensemble: Ensemble, cases: IntArray, times: FloatArray | None
) -> dict[str, FloatArray]:
    """Return values (cases, ...) of the responses that all the cases have."""
    block = max(1, _STATES // int(ensemble.steps_stored.max()))
    parts = [cases[start : start + block] for start in range(0, len(cases), block)]
    read = [dict(_read_responses(ensemble, part, times)) for part in parts]
    values = {name: np.concatenate([part[name] for part in read]) for name in read[0]}
    for name in [name for name in values if name not in (*MAIN_END_VALUES, *DEPTHS)]:
        if not (end_value_of(name)[0].smooth and np.isfinite(values[name]).all()):
            del values[name]
    mid_points = ensemble.profiles("r", cases)
    same = mid_points is not None and np.ptp(mid_points, axis=0).max() <= 1e-9
    for name, largest in zip(DEPTHS, LARGEST, strict=True):
        wear = values.pop(name, None)
        if wear is not None and np.isfinite(wear).any(axis=-1).all():
            values[largest] = np.nanmax(wear, axis=-1)
            if same and np.isfinite(wear).all():
                values[name] = wear
    return values


def _read_responses(
    ensemble: Ensemble, cases: IntArray, times: FloatArray | None
) -> Iterator[tuple[str, FloatArray]]:
    """Yield final values and profiles of some cases, or those at times."""
    stored = ensemble.steps_stored[cases]
    if times is None:
        states = None
        for name, final in ensemble.final.items():
            yield name, final[cases]
    else:
        states = _States(ensemble.histories("time", cases), stored, times)
        for final_value in dict.fromkeys(end_value_of(name)[0] for name in ensemble.final):
            if final_value.source in AT_STATES:
                values = states.of(ensemble.histories(final_value.source, cases))
                yield from entries(final_value, values).items()
    for name in DEPTHS:
        table = ensemble.profiles(name, cases)
        if table is None or (table.ndim == 2 and states is not None):
            continue
        if states is not None:
            yield name, states.of(table)
        else:
            yield name, table if table.ndim == 2 else table[np.arange(len(table)), stored - 1]


class _States:
    """Stored states around some times of each case, and values between them.

    Times are (cases, steps), NaN behind the stored ones, at least two of each case. InputError
    where a case does not last until all times ``at`` (times,).
    """

    def __init__(self, time: FloatArray, stored: IntArray, at: FloatArray) -> None:
        self._cases = np.arange(len(time))[:, None]
        end = float(time[self._cases[:, 0], stored - 1].min())
        outside = at[(at < 0.0) | (at > end * (1.0 + 1e-9))]
        if len(outside):
            raise InputError(
                f"times = {outside[0]:.9g}: must be from 0 to {end:.9g} s, where a case ends"
            )
        self._after = np.array([
            np.clip(np.searchsorted(t[:n], at), 1, n - 1)
            for t, n in zip(time, stored, strict=True)
        ])  # fmt: skip
        before, after = time[self._cases, self._after - 1], time[self._cases, self._after]
        self._share = np.clip((at - before) / (after - before), 0.0, 1.0)

    def of(self, table: FloatArray) -> FloatArray:
        """Return values (cases, times, ...) of a table (cases, steps, ...)."""
        share = self._share.reshape(*self._share.shape, *(1,) * (table.ndim - 2))
        before = table[self._cases, self._after - 1]
        return before + share * (table[self._cases, self._after] - before)
