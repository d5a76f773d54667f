"""``rw.function``: numbers of wear histories as a function of numbers of their case."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import SAME_TIME, Case, refuse_stop
from ringwear_par.cases.files.keys import override, read_keys
from ringwear_par.cases.files.reading import make_case, read_case
from ringwear_par.cases.schema import unit_of, unit_under
from ringwear_par.cases.smooth_keys import smooth_keys
from ringwear_par.cases.tables import name_unknown_keys
from ringwear_par.cases.units import seconds
from ringwear_par.cases.values import RejectedError, is_number
from ringwear_par.errors import InputError, RingwearError, legible
from ringwear_par.files.text import shortened
from ringwear_par.results.result import Result
from ringwear_par.results.variables import HISTORIES, LAYER_HISTORIES, Variable, layer_names
from ringwear_par.studies.variations import name_fault, own_key, value_of, without_units

if TYPE_CHECKING:
    from mpi4py import MPI

#: steps between stored states where only the last state is needed
_RARELY = 10**9
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
        rows: list[Any] = []
        for result in outcomes:
            if isinstance(result, Result):
                times, values = result.data["time"], np.asarray(result.data[self.variable.name])
                row = int(np.searchsorted(times, self.time * (1.0 - 2.0 * SAME_TIME)))
                rows.append(values if self.whole else values[[min(row, len(times) - 1)]])
            else:
                rows.append([] if self.whole else [np.nan])
        table = np.full((len(rows), max(map(len, rows), default=0)), np.nan)
        for n, values in enumerate(rows):
            table[n, : len(values)] = values
        return table if self.whole else table.reshape(len(rows))


@dataclass(eq=False, repr=False)
class Function:
    """Numbers of wear histories as a function of numbers of a case, see ``function``.

    It can be pickled. MPI starts with the first call.
    """

    #: dotted keys and raw values of the case
    keys: Mapping[str, Any]
    #: keys of its numbers that vary, and their values
    inputs: Mapping[str, float]
    outputs: Sequence[Output]
    #: whether it returns derivatives, too
    derivatives: bool
    #: why cases of the last call failed, by number of the case
    errors: dict[int, RingwearError] = field(default_factory=dict)

    def __repr__(self) -> str:
        outputs = ", ".join(output.text for output in self.outputs)
        return f"<Function: {', '.join(self.inputs)} -> {outputs}>"

    @property
    def schema(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Units and meanings of "inputs" and "outputs" by name; of inputs bounds and values too.

        Bounds are None where there is none; values are those of the case.
        """
        outputs = {
            output.text: {"unit": output.variable.unit, "meaning": output.variable.meaning}
            for output in self.outputs
        }
        inputs = {}
        for name, value in self.inputs.items():
            bounds = [end if math.isfinite(end) else None for end in _ends(name)]
            unit = unit_under(name, lambda law: [value_of(self.keys, law)]) or "1"
            about = {"unit": unit, "bounds": bounds, "meaning": own_key(name).meaning}
            inputs[name] = {**about, "value": value}
        return {"inputs": inputs, "outputs": outputs}

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
        points, shape = self._points(values)
        if self.derivatives:
            steps = self._steps(points[:, 0])
            moved = points + steps[:, None] * np.eye(points.shape[2])
            points = np.concatenate([points, moved], axis=1)
        count, width, inputs = points.shape
        cases = [self._case(row) for row in points.reshape(-1, inputs).tolist()]
        ends = self._step_ends(cases, comm, width) if self.derivatives else None
        outcomes = _outcomes(cases, comm, ends)
        errors = enumerate(outcomes)
        self.errors = {n // width: e for n, e in errors if isinstance(e, RingwearError)}
        outputs, derivatives = {}, {}
        for output in self.outputs:
            states = output.of(outcomes)
            size = (*shape, *states.shape[1:])
            states = states.reshape(count, width, *states.shape[1:])
            outputs[output.text] = states[:, 0].reshape(size)[()]
            for j, name in enumerate(self.inputs if self.derivatives else ()):
                moved = np.moveaxis(states[:, 1 + j] - states[:, 0], 0, -1)
                slope = np.moveaxis(moved / steps[:, j], -1, 0)
                derivatives[output.text, name] = slope.reshape(size)[()]
        return (outputs, derivatives) if self.derivatives else outputs

    def _points(self, values: Mapping[str, Any]) -> tuple[FloatArray, tuple[int, ...]]:
        """Return the inputs of each case, (cases, 1, inputs), and the shape they go together to."""
        values = dict(values)  # of a table of pandas its columns
        faults: list[str] = []
        name_unknown_keys("function", map(str, values), list(self.inputs), faults)
        faults += [f"function: {name}: is missing" for name in self.inputs if name not in values]
        if faults:
            raise InputError(*faults)
        columns = np.broadcast_arrays(*(_numbers(name, values[name]) for name in self.inputs))
        points = np.stack([column.ravel() for column in columns], axis=-1)
        return points[:, None], columns[0].shape

    def _case(self, row: Sequence[float]) -> Case | InputError:
        """Return the case with other numbers, or all its faults."""
        try:
            return make_case(override(self.keys, dict(zip(self.inputs, row, strict=True))), "case")
        except InputError as error:
            return error

    def _steps(self, points: FloatArray) -> FloatArray:
        """Return the differences (cases, inputs) by which inputs are moved, within their bounds."""
        steps = _STEP * np.where(points == 0.0, 1.0, np.abs(points))
        most = [_ends(name)[1] for name in self.inputs]
        return np.where(points + steps > most, -steps, steps)

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
        for n, result in enumerate(_outcomes(alone, comm)):
            if isinstance(result, Result):
                made, case = result.histories["time"][1:], cases[n * width]
                asked = [t for t in case.output.times if np.abs(made - t).min() > SAME_TIME * t]
                ends += [sorted([*made.tolist(), *asked])] * width
            else:
                cases[n * width : (n + 1) * width] = [result] * width
                ends += [None] * width
        return ends


def _ends(name: str) -> tuple[float, float]:
    """Return the bounds of an input, infinite for none."""
    interval = own_key(name).numbers
    return (-math.inf, math.inf) if interval is None else (interval.low, interval.high)


def _numbers(name: str, value: Any) -> FloatArray:
    """Return an input as an array of numbers in the case's unit."""
    raw = np.asarray(value, dtype=object)
    numbers = np.empty(raw.shape)
    for place, entry in np.ndenumerate(raw):
        entry = entry.item() if isinstance(entry, np.generic) else entry
        try:
            number, reason = without_units(name, entry), ""
        except RejectedError as error:
            number, reason = None, f" ({error})"
        if not is_number(number):
            unit = f" ({unit_of(name)})" if unit_of(name) else ""
            raise InputError(
                f"function: {name} = {shortened(entry)}: must be a number, or an array of "
                f"numbers{unit}{reason}"
            )
        numbers[place] = number
    return numbers


def _outcomes(
    cases: Sequence[Any], comm: "MPI.Comm | None", ends: Sequence[Any] | None = None
) -> list[Result | RingwearError]:
    """Return the result of each case, or why it has none. Collective on comm.

    Parameters
    ----------
    cases : or errors, which stay.
    ends : s, of the steps of each case; None: as the cases say.
    """
    from mpi4py import MPI  # starts MPI

    from ringwear_par.studies.many import results_of

    results = results_of(cases, MPI.COMM_WORLD if comm is None else comm, step_times=ends)
    return [result if isinstance(result, Result) else result.error for result in results]


# -- reading ---------------------------------------------------------------------------------------


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
    for what, names, such in (("inputs", inputs, "wear.lower.k"), ("outputs", outputs, "torque")):
        if isinstance(names, str) or not names or not all(isinstance(n, str) for n in names):
            raise InputError(
                f"function: {what} = {shortened(names)}: must be a list of names, as ['{such}']"
            )
    if derivatives and base.follows_wear:
        raise InputError(
            'function: mesh.geometry = "updated": has no derivatives; must be "fixed" with them'
        )
    base = base.replace({})  # refused where its text does not tell its keys
    keys, faults = read_keys(base.text), list[str]()
    read = _read_outputs(base, outputs, faults)
    values = _read_inputs(base, keys, inputs, derivatives, faults)
    if faults:
        raise InputError(*faults)
    made = Function(override(keys, _storing(base, read)), values, read, derivatives)
    if isinstance(error := made._case([*values.values()]), InputError):
        raise error
    return made


def _read_inputs(
    case: Case,
    keys: Mapping[str, Any],
    names: Sequence[str],
    derivatives: bool,
    faults: list[str],
) -> dict[str, float]:
    """Return the values of the inputs in the case, and add the faults of those that are none."""
    force: Any = case.load.force
    if is_number(force):  # or its pressure
        keys = {"load.force": force, "load.pressure": force / case.area, **keys}
    values = {}
    for name in names:
        if fault := name_fault(f"function: inputs: {legible(name)}", name, name):
            faults.append(fault)
        elif is_number(value := value_of(keys, name)):
            values[name] = float(value)
        else:
            state = "is not in it" if value is None else f"= {shortened(value)}"
            faults.append(f"function: inputs: {name} {state}: must be a number in the case")
    if derivatives:
        no = "has no derivatives, as the history does not depend on it smoothly"
        name_unknown_keys("function: inputs", values, list(smooth_keys(case)), faults, no)
    return values


def _read_outputs(case: Case, texts: Sequence[str], faults: list[str]) -> list[Output]:
    """Return the outputs, and add the faults of those that are none."""
    names = layer_names((bool(case.lower.layers), bool(case.upper.layers)))
    known = {**HISTORIES, **{n: LAYER_HISTORIES[n] for n in names if n in LAYER_HISTORIES}}
    outputs: list[Output] = []
    for text in texts:
        name, at, word = (part.strip() for part in text.partition("@"))
        if name not in known:
            name_unknown_keys("function: outputs", [name], list(known), faults, "unknown name")
            continue
        try:
            time = seconds(word) if at and word != "all" else math.inf
        except (RejectedError, ValueError):
            time = math.nan
        if not (0.0 <= time <= case.time.end * (1.0 + SAME_TIME) or time == math.inf):
            faults.append(
                f"function: outputs: {legible(text)}: behind @ must be all, or a time (s, or with "
                f"its unit) from 0 to time.end = {case.time.end:g}"
            )
        outputs.append(Output(text, known[name], time, word == "all"))
    return outputs


def _storing(case: Case, outputs: Sequence[Output]) -> dict[str, Any]:
    """Return changes of a case with which its histories hold some outputs, and little else."""
    changes: dict[str, Any] = {"output.fields": [], "output.boundary": None, "stress": None}
    if times := {o.time for o in outputs if 0.0 < o.time < math.inf}:
        changes["output.times"] = sorted(times | {*(case.output.times or ())})
    elif not any(o.whole for o in outputs):
        changes["output.every"] = _RARELY
    return changes
