"""The outputs of a function: variables of histories at the last step, a time or all states."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import SAME_TIME, Case
from ringwear_par.cases.tables import name_unknown_keys
from ringwear_par.cases.units import seconds
from ringwear_par.cases.values import RejectedError
from ringwear_par.errors import InputError, legible
from ringwear_par.files.text import shortened
from ringwear_par.results.variables import (
    D_HISTORIES,
    HISTORIES,
    LAYER_HISTORIES,
    Variable,
    derivative_of,
    layer_names,
)

#: steps between stored states where only the last state is needed
_RARELY = 10**9


class Output(NamedTuple):
    """A variable of histories, and at which states."""

    #: as users name it: NAME, NAME@t or NAME@all
    text: str
    #: a number at each stored state
    variable: Variable
    #: s, inf for the last state
    time: float
    #: whether of all states
    whole: bool

    @property
    def meaning(self) -> str:
        """What it is, in words."""
        if self.whole:
            return f"{self.variable.meaning}, at all stored states"
        when = "last step" if math.isinf(self.time) else f"time {self.time:g} s"
        return f"{self.variable.meaning}, at the {when}"

    def at(self, times: FloatArray, values: FloatArray) -> Any:
        """Return it of values whose last axis is that of the stored states, at some times (s)."""
        if self.whole:
            return values
        row = int(np.searchsorted(times, self.time * (1.0 - 2.0 * SAME_TIME)))
        return values[..., min(row, len(times) - 1)]


def read_outputs(case: Case, texts: Sequence[str], derivatives: bool) -> tuple[Output, ...]:
    """Return the outputs of a function. Not collective.

    Parameters
    ----------
    derivatives : whether all of them are to have derivatives.

    Raises
    ------
    InputError : all faults, one sentence each.
    """
    if isinstance(texts, str) or not texts or not all(isinstance(text, str) for text in texts):
        raise InputError(
            f"function: outputs = {shortened(texts)}: must be a list of names, as ['penetration']"
        )
    lower, upper = (bool(ring.layers) for ring in case.rings)
    layer_histories = [name for name in layer_names((lower, upper)) if name in LAYER_HISTORIES]
    variables = HISTORIES | {name: LAYER_HISTORIES[name] for name in layer_histories}
    if derivatives:
        variables = {n: v for n, v in variables.items() if derivative_of(v).name in D_HISTORIES}
    outputs: list[Output] = []
    faults: list[str] = []
    for text in texts:
        name, at, word = (part.strip() for part in text.partition("@"))
        if name not in variables:
            no = (
                "has no derivatives" if name in {**HISTORIES, **LAYER_HISTORIES} else "unknown name"
            )
            name_unknown_keys("function: outputs", [name], list(variables), faults, no)
            continue
        try:
            time = _time(word) if at and word != "all" else math.inf
        except RejectedError:
            faults.append(
                f"function: outputs: {legible(text)}: behind @ must be all, or a time from 0 on "
                "(s, or with its unit)"
            )
            continue
        outputs.append(Output(text, variables[name], time, word == "all"))
    if faults:
        raise InputError(*faults)
    return tuple(outputs)


def _time(word: str) -> float:
    try:
        time = seconds(word)
    except ValueError as error:
        raise RejectedError from error
    if not 0.0 <= time < math.inf:
        raise RejectedError
    return time


def storing(case: Case, outputs: Sequence[Output]) -> dict[str, Any]:
    """Return changes of a case with which its histories hold some outputs, and little else.

    Raises
    ------
    InputError : outputs after the end; the case has no times for outputs of all states, and others
        are at times.
    """
    changes: dict[str, Any] = {"output.fields": [], "output.boundary": None, "stress": None}
    times = {o.time for o in outputs if 0.0 < o.time < math.inf}
    field = next((o.text for o in outputs if o.whole), "")
    if times and field and not case.output.times:
        raise InputError(
            f"function: outputs: {field}: needs output.times in the case, beside outputs at times"
        )
    end = case.time.end * (1.0 + SAME_TIME)
    if late := [o for o in outputs if end < o.time < math.inf]:
        raise InputError(
            *(
                f"function: outputs: {legible(o.text)}: {o.time:g} s is after the end of the case; "
                f"must be <= time.end = {case.time.end:g} (s)"
                for o in late
            )
        )
    if times:
        times |= {*case.output.times} if field else set()
        changes["output.times"] = sorted(times)
    elif not field:
        changes["output.every"] = _RARELY
    return changes
