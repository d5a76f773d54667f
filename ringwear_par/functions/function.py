"""``rw.function``: numbers of histories, its outputs, as a function of numbers of their case."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import SAME_TIME, Case, refuse_stop
from ringwear_par.cases.files.reading import read_case
from ringwear_par.cases.smooth_keys import smooth_keys
from ringwear_par.cases.tables import name_unknown_keys
from ringwear_par.cases.units import seconds
from ringwear_par.cases.values import RejectedError
from ringwear_par.errors import InputError, RingwearError, legible
from ringwear_par.files.text import shortened
from ringwear_par.functions.inputs import CaseInputs, case_inputs
from ringwear_par.results.result import Result
from ringwear_par.results.variables import HISTORIES, LAYER_HISTORIES, Variable, layer_names

if TYPE_CHECKING:
    from mpi4py import MPI

#: steps between stored states where only the last state is needed
_RARELY = 10**9
#: variables without derivatives: counts, and where histories are at
_NOT_SMOOTH = ("time", "contact_iterations")
#: difference of an input over itself, or over 1 of its unit where it is 0
_STEP = 1e-5


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

    def of(self, outcomes: Sequence[Result | RingwearError]) -> FloatArray:
        """Return it of all cases, (cases,) or (cases, states).

        NaN where a case failed, and behind the last state of a case.
        """
        name, rows = self.variable.name, []
        for result in outcomes:
            values = np.full(0 if self.whole else 1, np.nan)
            if isinstance(result, Result):
                histories = result.histories if name in HISTORIES else result.layers
                times, values = np.asarray(result.histories["time"]), np.asarray(histories[name])
                if not self.whole:
                    row = int(np.searchsorted(times, self.time * (1.0 - 2.0 * SAME_TIME)))
                    values = values[[min(row, len(times) - 1)]]
            rows.append(values)
        table = np.full((len(rows), max(map(len, rows), default=0)), np.nan)
        for n, values in enumerate(rows):
            table[n, : len(values)] = values
        return table if self.whole else table.reshape(len(rows))


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
    known = HISTORIES | {name: LAYER_HISTORIES[name] for name in layer_histories}
    smooth = {name: v for name, v in HISTORIES.items() if name not in _NOT_SMOOTH}
    allowed = smooth if derivatives else known
    outputs: list[Output] = []
    faults: list[str] = []
    for text in texts:
        name, at, word = (part.strip() for part in text.partition("@"))
        if name not in allowed:
            no = "has no derivatives" if name in known else "unknown name"
            name_unknown_keys("function: outputs", [name], list(allowed), faults, no)
            continue
        try:
            time = seconds(word) if at and word != "all" else math.inf
        except (RejectedError, ValueError):
            time = math.nan
        if not time >= 0.0:
            sentence = "behind @ must be all, or a time from 0 on (s, or with its unit)"
            faults.append(f"function: outputs: {legible(text)}: {sentence}")
        outputs.append(Output(text, allowed[name], time, word == "all"))
    if faults:
        raise InputError(*faults)
    return tuple(outputs)


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
            f"function: outputs: {legible(late[0].text)}: {late[0].time:g} s is after the end of "
            f"the case; must be <= time.end = {case.time.end:g} (s)"
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
            output.text: {"unit": output.variable.unit, "meaning": output.variable.meaning}
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
        InputError : inputs that are missing, unknown or no numbers.
        ValueError : inputs that do not broadcast together.
        """
        rows, shape = self._inputs.rows(values)
        points = np.reshape(np.array(rows, dtype=float), (len(rows), 1, len(self._inputs.names)))
        if self._derivatives:
            steps = self._steps(points[:, 0])
            moved = points + steps[:, None] * np.eye(points.shape[2])
            points = np.concatenate([points, moved], axis=1)
        count, width, inputs = points.shape
        cases = [self._inputs.case(row) for row in points.reshape(-1, inputs).tolist()]
        ends = self._step_ends(cases, comm, width) if self._derivatives else None
        outcomes = self._outcomes(cases, comm, ends)
        errors = enumerate(outcomes)
        self.errors = {n // width: e for n, e in errors if isinstance(e, RingwearError)}
        outputs, derivatives = {}, {}
        for output in self._outputs:
            states = output.of(outcomes)
            size = (*shape, *states.shape[1:])
            states = states.reshape(count, width, *states.shape[1:])
            outputs[output.text] = states[:, 0].reshape(size)[()]
            for j, name in enumerate(self._inputs.names if self._derivatives else ()):
                moved = np.moveaxis(states[:, 1 + j] - states[:, 0], 0, -1)
                slope = np.moveaxis(moved / steps[:, j], -1, 0)
                derivatives[output.text, name] = slope.reshape(size)[()]
        return (outputs, derivatives) if self._derivatives else outputs

    def _steps(self, points: FloatArray) -> FloatArray:
        """Return the differences (cases, inputs) by which inputs are moved, within their bounds."""
        steps = _STEP * np.where(points == 0.0, 1.0, np.abs(points))
        ends = [entry["bounds"][1] for entry in self._inputs.schema().values()]
        most = np.array([np.inf if end is None else end for end in ends])
        return np.where(points + steps > most, -steps, steps)

    def _outcomes(
        self, cases: Sequence[Any], comm: "MPI.Comm | None", ends: Sequence[Any] | None = None
    ) -> list[Result | RingwearError]:
        """Return the result of each case, or why it has none. Collective on comm.

        Parameters
        ----------
        cases : or errors, which stay.
        ends : s, of the steps of each case; None: as the cases say.
        """
        from mpi4py import MPI  # starts MPI

        from ringwear_par.studies.many import results_of

        good = [n for n, case in enumerate(cases) if isinstance(case, Case)]
        step_times = None if ends is None else [ends[n] for n in good]
        world = MPI.COMM_WORLD if comm is None else comm
        results = results_of([cases[n] for n in good], world, step_times=step_times)
        outcomes = list(cases)
        for n, result in zip(good, results, strict=True):
            outcomes[n] = result if isinstance(result, Result) else result.error
        return outcomes

    def _step_ends(self, cases: list[Any], comm: "MPI.Comm | None", width: int) -> list[Any] | None:
        """Return the ends of the steps that the first of each ``width`` cases makes, s, for all.

        What error control would change between them is no derivative. At times of output steps end,
        too. None of fixed steps; cases whose first one fails are replaced by why. Collective on
        comm.
        """
        if not any(isinstance(case, Case) and case.time.adaptive for case in cases):
            return None
        every_step = {"output.every": 1, "output.times": None}
        alone = [c.replace(every_step) if isinstance(c, Case) else c for c in cases[::width]]
        ends: list[Any] = []
        for n, result in enumerate(self._outcomes(alone, comm)):
            if isinstance(result, Result):
                made, case = result.histories["time"][1:], cases[n * width]
                asked = [t for t in case.output.times if np.abs(made - t).min() > SAME_TIME * t]
                ends += [sorted([*made.tolist(), *asked])] * width
            else:
                cases[n * width : (n + 1) * width] = [result] * width
                ends += [None] * width
        return ends


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
    if derivatives and base.follows_wear:
        raise InputError(
            'function: mesh.geometry = "updated": has no derivatives; must be "fixed" with them'
        )
    faults: list[str] = []
    if derivatives:
        no = "has no derivatives, as the history does not depend on it smoothly"
        name_unknown_keys("function: inputs", inputs, list(smooth_keys(base)), faults, no)
    if faults:
        raise InputError(*faults)
    return Function(changed, read, derivatives)
