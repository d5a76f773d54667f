"""What a history stores while it is stepped: rows in memory, which make its result."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.elasticity.boundary_fields import BoundaryState
from ringwear_par.results.checkpoints import Checkpoint
from ringwear_par.results.result import Result, balance_attributes
from ringwear_par.results.variables import HISTORIES

if TYPE_CHECKING:
    from ringwear_par.history.model import State, WearHistory


def row(history: "WearHistory", state: "State") -> dict[str, Any]:
    """Return what a state says of the result's variables, by name.

    All but ``penetration`` and ``contact_iterations``, which other states have a part in.
    """
    contact = state.contact
    volumes = history.worn_volumes(state.wear)
    return {
        "time": state.time,
        "approach": contact.approach,
        "force": contact.force,
        "torque": history.torque(contact.pressure),
        "twist": history.twist(contact.pressure),
        "worn_volume_lower": volumes[0],
        "worn_volume_upper": volumes[1],
        "dissipated_energy": state.energy,
        "pressure": contact.pressure,
        "gap": contact.gap,
        "wear_lower": state.wear[0],
        "wear_upper": state.wear[1],
    }


class Recorder:
    """Stores the states of a history that its case asks for, in memory.

    Parameters
    ----------
    history : the wear history.
    """

    def __init__(self, history: "WearHistory") -> None:
        output = history.case.output
        self._history = history
        #: whether the profiles are stored as often as the histories, or at the last state only
        self.deep = output.profiles == "all"
        self._steps: list[int] = []
        self._histories: dict[str, list[float]] = {name: [] for name in HISTORIES}
        self._profiles: dict[str, list[FloatArray]] = {name: [] for name in output.fields}
        self._boundary: list[BoundaryState] = []
        #: iterations of the contact solver since the last stored state
        self.pending_iterations = 0

    def add(self, state: "State") -> None:
        """Take a new state; store it if it is one of those asked for."""
        self.pending_iterations += state.contact.iterations
        if not state.stored:
            return
        values = row(self._history, state)
        start = (*self._histories["approach"], values["approach"])[0]
        values["penetration"] = values["approach"] - start
        values["contact_iterations"] = self.pending_iterations
        self._steps.append(state.step)
        for name, column in self._histories.items():
            column.append(values[name])
        for name, rows in self._profiles.items():
            if not self.deep:
                rows.clear()
            rows.append(values[name])
        if state.boundary is not None:
            self._boundary.append(BoundaryState(state.step, state.time, state.boundary))
        self.pending_iterations = 0

    @property
    def stored(self) -> int:
        """Number of stored states."""
        return len(self._steps)

    @property
    def steps(self) -> IntArray:
        """(stored,) int, numbers of steps made; not increasing where there are times of output."""
        return np.array(self._steps, dtype=np.int64)

    @property
    def rows(self) -> IntArray:
        """(stored,) int, what the rows are called: by steps made, or numbered at given times."""
        return np.arange(self.stored) if self._history.case.output.times else self.steps

    @property
    def histories(self) -> dict[str, Any]:
        """(stored,) each, by name."""
        return {
            name: np.array(column, dtype=HISTORIES[name].dtype)
            for name, column in self._histories.items()
        }

    @property
    def profiles(self) -> dict[str, FloatArray]:
        """(stored, n) float each, by name; (n,) where the last ones are stored only."""
        if not self.stored:
            return {}
        return {
            name: np.array(rows if self.deep else rows[-1])
            for name, rows in self._profiles.items()
        }  # fmt: skip

    @property
    def boundary(self) -> Sequence[BoundaryState]:
        """Stored fields on the whole boundaries."""
        return self._boundary

    def arrays(self) -> dict[str, FloatArray]:
        """Return what is stored so far by variable, ``step`` (what rows are called) included."""
        line = self._history.pair.line
        return {
            "step": self.rows.astype(float),
            **self.histories,
            "r": line.r,
            "width": line.width,
            **self.profiles,
        }

    def result(
        self,
        attributes: Mapping[str, Any],
        balances: Mapping[str, float],
        checkpoint: Checkpoint | None = None,
    ) -> Result:
        """Return what is stored so far.

        Parameters
        ----------
        attributes : of the file, beside case, title and balances.
        balances : the worst defects so far, by name.
        checkpoint : of the last state, stored or not; None: nothing will go on from here.
        """
        case = self._history.case
        return Result(
            self._history.pair.line,
            self.rows,
            self.steps,
            self.histories,
            self.profiles,
            tuple(self._boundary),
            {
                "case": case.text,
                "title": case.title,
                **attributes,
                **balance_attributes(balances),
            },
            checkpoint,
        )

    def restore(self, result: Result) -> None:
        """Put the stored rows of an interrupted run back, as far as the case still stores them."""
        assert result.checkpoint is not None
        reached = result.checkpoint.numbers
        case, stores = self._history.case, self._history.stores
        steps, times = result.steps_made.tolist(), result.histories["time"].tolist()
        # the last one of a shorter run may not belong here
        keep = np.array([stores(n, t) for n, t in zip(steps, times, strict=True)])
        self._steps = result.steps_made[keep].tolist()
        self._histories = {name: result.histories[name][keep].tolist() for name in HISTORIES}
        for name in self._profiles:
            stored = result.profiles[name]
            self._profiles[name] = list(stored[keep] if self.deep else stored[None])
        # the last state of a shorter run is not the last one of this run
        if case.output.boundary != "last" or case.time.finished(
            int(reached["step"]), float(reached["time"])
        ):
            left = set(result.histories["time"][keep].tolist())
            self._boundary = [b for b in result.boundary if b.time in left]
        self.pending_iterations = int(reached["pending_iterations"]) + int(
            result.histories["contact_iterations"][~keep].sum()
        )
