"""Rows of the variables that the cases of a block store."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.case import SAME_TIME, Case
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.history.block import Block
from ringwear_par.history.layers import layer_left, layer_volumes
from ringwear_par.history.loop import Instant
from ringwear_par.history.state import State
from ringwear_par.history.stresses import Moment
from ringwear_par.results.result import Result
from ringwear_par.results.variables import HISTORIES, VARIABLES, layer_names

Value = Callable[[Block, State], FloatArray]
#: what is noted of each row beside its variables
_NOTED = ("number", "steps", "iterations")


def _twist(block: Block, state: State) -> FloatArray:
    """Return the area mean of the circumferential displacement jump, (B,) mm."""
    line, pair, soft = block.line, block.compliance.pair, block.compliance.softness
    per_shear = np.array([of.twist for of in line.pairs])[pair] / line.area.sum()
    jump = np.einsum("bi,bin,bn->b", soft, per_shear, state.pressure)
    return block.friction.at(state.time) * jump


def _gap(block: Block, state: State) -> FloatArray:
    """Return the gaps of the bodies under pressure, (B, n) mm; in contact 0 but for round-off."""
    p = state.pressure
    gap = block.compliance.gap(block.worn_gap(state.wear), p, state.approach)
    return np.where(p > 0.0, 0.0, np.maximum(gap, 0.0))


def _layers(block: Block, state: State, body: int) -> tuple[FloatArray, FloatArray]:
    """Return the ends of the layers of a body, and its wear, (layers + 1, B, n) and (B, n) mm."""
    for wearing, wear in zip(block.wearing, state.wear, strict=True):
        if wearing.body == body:
            return wearing.ends, wear
    case = block.cases.every[0]
    ends = np.append(case.layer_ends(body), np.full((1, case.line.n), np.inf), axis=0)
    return np.repeat(ends[:, None], len(block), axis=1), np.zeros_like(block.gap)


def _left(block: Block, state: State, body: int) -> FloatArray:
    return layer_left(*_layers(block, state, body))


def _share_through(block: Block, state: State, body: int) -> FloatArray:
    through = _left(block, state, body) <= 0.0
    return through @ block.line.area / (np.ones_like(through) @ block.line.area)  # 1 at most


def _volumes(block: Block, state: State, body: int) -> FloatArray:
    return layer_volumes(block.line.area, *_layers(block, state, body))


def _volume(block: Block, state: State, body: int) -> FloatArray:
    return _wear(block, state, body) @ block.line.area


def _wear(block: Block, state: State, body: int) -> FloatArray:
    return block.both(state.wear)[body]


#: the variables of results by name, (B,) or (B, n), but for contact_iterations
VALUES: Mapping[str, Value] = {
    "time": lambda block, state: state.time,
    "approach": lambda block, state: state.approach,
    "penetration": lambda block, state: state.approach - state.first_approach,
    "force": lambda block, state: state.pressure @ block.line.area,
    "torque": lambda block, state: block.friction.at(state.time) * block.moment(state.pressure),
    "twist": _twist,
    "dissipated_energy": lambda block, state: state.energy,
    "normal_work": lambda block, state: state.normal_work,
    "pressure": lambda block, state: state.pressure,
    "gap": _gap,
    **{
        f"{name}_{body}{rest}": partial(function, body=i)
        for i, body in enumerate(BODIES)
        for name, rest, function in (
            ("wear", "", _wear),
            ("worn_volume", "", _volume),
            ("share_through", "", _share_through),
            ("layer_left", "", _left),
            ("worn_volume", "_layers", _volumes),
        )
    },
}


class Columns(NamedTuple):
    """Rows of B histories, those of history i are ``offsets[i]`` to ``offsets[i + 1]``."""

    #: (B + 1,) int, and (rows,) int, steps made
    offsets: IntArray
    steps: IntArray
    #: (rows, ...) each, by name, see ``variables``
    data: dict[str, Any]
    #: (B, n) each, by name, where the last profiles are stored alone: NaN where there is none
    last: dict[str, Any]


class Rows:
    """The stored states of the histories of a block, as they come.

    Parameters
    ----------
    cases : of one ``block_key``.
    """

    def __init__(self, cases: Sequence[Case]) -> None:
        case, count = cases[0], len(cases)
        self._output, self._count = case.output, count
        layers = len(case.lower.layers), len(case.upper.layers)
        sizes = {"element": case.line.n, "layer": 1 + layers[0], "layer_upper": 1 + layers[1]}
        self._rows: dict[str, list[Any]] = {name: [np.empty(0, np.int64)] for name in _NOTED}
        #: of each history the last profiles, where these alone are stored
        self._last: dict[str, FloatArray] = {}
        of_layers = layer_names((layers[0] > 0, layers[1] > 0))
        for name in (*HISTORIES, *of_layers, *case.output.fields):
            variable = VARIABLES[name]
            shape = [sizes[axis] for axis in variable.dimensions[1:]]
            if case.output.profiles == "last" and "element" in variable.dimensions:
                self._last[name] = np.full((count, *shape), np.nan)
            elif name != "contact_iterations":
                self._rows[name] = [np.empty((0, *shape), variable.dtype)]
        #: (B,) s, time of the last stored state; negative: there is none
        self.last_time = np.full(count, -1.0)

    def __call__(self, instant: Instant) -> None:
        """Take new states, all of which are to be stored."""
        number = instant.block.number
        for name, values in _values(instant, self._rows).items():
            self._rows[name].append(values)
        for name, values in _values(instant, self._last).items():
            self._last[name][number] = values
        self.last_time[number] = instant.state.time

    def restore(self, before: Result) -> FloatArray:
        """Take the rows of an interrupted single history that its case stores; return their times.

        The last row of a history that was stopped, or ends later now, may not be among them.
        """
        times, output = np.asarray(before.data["time"]), self._output
        if output.times:
            near = np.abs(times[:, None] - output.times) <= SAME_TIME * times[:, None]
            rows = (times == 0.0) | near.any(axis=1)
        else:
            rows = before.step % output.every == 0
        steps = before.step[rows]
        noted = {
            "number": np.zeros(len(steps), np.int64),
            "steps": steps,
            "iterations": np.cumsum(before.data["contact_iterations"])[rows],
        }
        for name, parts in self._rows.items():
            parts.append(noted[name] if name in noted else np.asarray(before.data[name])[rows])
        for name, last in self._last.items() if rows[-1] else ():
            last[0] = before.data[name]
        self.last_time[0] = times[rows][-1]
        return times[rows]

    def columns(self, unstored: Instant | None = None) -> "Columns":
        """Return all rows, by history.

        Parameters
        ----------
        unstored : the state that a single history has come to, if that is not stored.
        """
        rows, last = self._rows, self._last
        if unstored is not None:
            rows = {n: [*rows[n], values] for n, values in _values(unstored, rows).items()}
            last = _values(unstored, last)
        order = np.argsort(np.concatenate(rows["number"]), kind="stable")
        columns = {name: np.concatenate(parts)[order] for name, parts in rows.items()}
        numbers, steps, made = (columns.pop(name) for name in _NOTED)
        offsets = np.searchsorted(numbers, np.arange(self._count + 1))
        columns["contact_iterations"] = _since(made, offsets)
        return Columns(offsets, steps, columns, last)


def _values(instant: Instant, names: Iterable[str]) -> dict[str, Any]:
    """Return what is stored of states under these names."""
    block, state = instant.block, instant.state
    noted = {"number": block.number, "steps": state.steps, "iterations": state.iterations}
    return {n: noted[n] if n in noted else VALUES[n](block, state) for n in names}


def _since(made: IntArray, offsets: IntArray) -> IntArray:
    """Return how many iterations each row took since the row before of its history."""
    since = np.diff(made, prepend=0)
    firsts = offsets[:-1][np.diff(offsets) > 0]
    since[firsts] = made[firsts]
    return since


def moment(instant: Instant, place: int) -> Moment:
    """Return one of the states of an instant."""
    block, state = instant.block, instant.state
    return Moment(
        float(state.time[place]), int(state.steps[place]), bool(instant.ended[place]),
        state.pressure[place], float(state.approach[place]), block.both(state.wear)[:, place],
        None if state.meshed is None else block.both(state.meshed)[:, place],
    )  # fmt: skip
