"""``rw.function``: numbers of histories, its outputs, as a function of numbers of their case."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import SAME_TIME, Case, refuse_stop
from ringwear_par.cases.files.reading import read_case
from ringwear_par.cases.tables import name_unknown_keys
from ringwear_par.cases.units import seconds
from ringwear_par.cases.values import RejectedError
from ringwear_par.errors import InputError, RingwearError, legible
from ringwear_par.files.text import shortened
from ringwear_par.functions.inputs import CaseInputs, case_inputs
from ringwear_par.history.derivatives.keys import check_derivatives
from ringwear_par.results.result import Result
from ringwear_par.results.variables import (
    D_HISTORIES,
    HISTORIES,
    LAYER_HISTORIES,
    Variable,
    derivative_of,
    layer_names,
)

if TYPE_CHECKING:
    from mpi4py import MPI

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


class Function:
    """Numbers of wear histories as a function of numbers of a case, see ``function``.

    It can be pickled. MPI starts with the first call.

    Parameters
    ----------
    inputs, outputs : of the function.
    derivatives : whether it returns derivatives, too.

    Attributes
    ----------
    errors : why cases of the last call failed, by number of the case.
    """

    def __init__(
        self, inputs: CaseInputs, outputs: Sequence[Output], derivatives: bool = False
    ) -> None:
        self._inputs, self._outputs, self._derivatives = inputs, tuple(outputs), derivatives
        self.errors: dict[int, RingwearError] = {}

    def __repr__(self) -> str:
        outputs = ", ".join(output.text for output in self._outputs)
        return f"<Function: {', '.join(self._inputs.names)} -> {outputs}>"

    @property
    def schema(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Units and meanings of "inputs" and "outputs" by name; of inputs bounds and values too.

        Bounds are None where there is none; values are those of the case.
        """
        outputs = {
            output.text: {"unit": output.variable.unit, "meaning": output.meaning}
            for output in self._outputs
        }
        return {"inputs": self._inputs.schema(), "outputs": outputs}

    def __call__(self, values: Mapping[str, Any], comm: "MPI.Comm | None" = None) -> Any:
        """Return the outputs, with derivatives a second dict of them. Collective on comm.

        Parameters
        ----------
        values : of all inputs: numbers in the case's units, texts with a unit, or arrays of them,
            which are broadcast together. The same on all ranks.
        comm : whose ranks share the cases out; None: the world's. ``MPI.COMM_SELF`` where each rank
            calls by itself.

        Returns
        -------
        dict by output, of arrays of the shape of the inputs, scalars for scalars; of outputs at all
        states with one more axis, the states. Derivatives by (output, input) likewise. NaN where a
        case failed, see ``errors``, and behind the last state of a case.

        Raises
        ------
        InputError : inputs that are missing, unknown, no numbers or do not broadcast together.
        """
        rows, shape = self._inputs.rows(values)
        outcomes = self._outcomes(rows, comm)
        self.errors = {n: e for n, e in enumerate(outcomes) if isinstance(e, RingwearError)}
        outputs = {output.text: _stacked(output, outcomes, shape) for output in self._outputs}
        if not self._derivatives:
            return outputs
        derivatives = {
            (output.text, name): _stacked(output, outcomes, shape, row)
            for output in self._outputs
            for row, name in enumerate(self._inputs.names)
        }
        return outputs, derivatives

    def _outcomes(
        self, rows: Sequence[Sequence[float]], comm: "MPI.Comm | None"
    ) -> list[Result | RingwearError]:
        """Return the result of each case, or why it has none. Collective on comm."""
        from ringwear_par.studies.many import simulate_all  # starts MPI

        outcomes: list[Any] = []
        for row in rows:
            try:
                outcomes.append(self._inputs.case(row))
            except InputError as error:
                outcomes.append(error)
        cases = [(n, case) for n, case in enumerate(outcomes) if isinstance(case, Case)]
        keys = self._inputs.names if self._derivatives else ()
        results = simulate_all([case for _, case in cases], comm, derivatives=keys)
        for (n, _), result in zip(cases, results, strict=True):
            outcomes[n] = result if isinstance(result, Result) else result.error
        return outcomes


def _stacked(
    output: Output,
    outcomes: Sequence[Result | RingwearError],
    shape: Sequence[int],
    row: int | None = None,
) -> Any:
    """Return an output of all cases, or its derivative with respect to an input, by its row."""
    name = output.variable.name
    values: dict[int, Any] = {}
    for n, result in enumerate(outcomes):
        if isinstance(result, Result):
            if row is not None:
                states = result.derivatives[derivative_of(output.variable).name][row]
            else:
                states = (result.histories if name in HISTORIES else result.layers)[name]
            values[n] = output.at(result.histories["time"], np.asarray(states))
    empty = (0,) if output.whole else ()
    width = max((np.shape(value) for value in values.values()), default=empty)
    stacked = np.full((len(outcomes), *width), np.nan)
    for n, value in values.items():
        stacked[(n, *map(slice, np.shape(value)))] = value
    return stacked.reshape((*shape, *width))[()]


def function(
    case: Case | str | Path | Mapping[str, Any],
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    derivatives: bool = False,
) -> Function:
    """Return numbers of histories as a function of numbers of a case, dict to dict. Not collective.

    Parameters
    ----------
    case : a case, or what ``read_case`` takes.
    inputs : keys of numbers of the case, such as "wear.lower.k" or "upper.r[1]".
    outputs : ``NAME`` of a variable of histories at the last step, ``NAME@t`` at a time (s, or with
        its unit), ``NAME@all`` at all stored states, times of other outputs among them.
    derivatives : whether calls return derivatives of the outputs with respect to the inputs, too.

    Returns
    -------
    Function : of a dict of numbers or arrays, to a dict of them.

    Raises
    ------
    InputError : all faults of the case, the inputs or the outputs; inputs or outputs without
        derivatives where these are wanted.

    Examples
    --------
    >>> import ringwear_par as rw
    >>> f = rw.function("scripts/cases/paper.toml", ["load.pressure"], ["penetration"])
    >>> f({"load.pressure": [60, 80]})["penetration"].round(5)
    array([0.00517, 0.00973])
    """
    base = case if isinstance(case, Case) else read_case(case)
    refuse_stop(base, "function", "in a function of a case")
    read = read_outputs(base, outputs, derivatives)
    changed = case_inputs(base, inputs, storing(base, read))
    if derivatives:
        check_derivatives(base, inputs)
    return Function(changed, read, derivatives)
