"""Results: the history of a case, just computed or read from its file; histories side by side."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.batched import one
from ringwear_par.elasticity.geometry.mesh import ContactLine
from ringwear_par.elasticity.stress.boundary_fields import BoundaryState
from ringwear_par.elasticity.stress.fields import StressHistory
from ringwear_par.errors import InputError, RingwearError, ValidityWarning
from ringwear_par.files.text import parse_toml
from ringwear_par.history.state import Progress, Start, State
from ringwear_par.results import variables as table
from ringwear_par.results.outcomes import Outcome
from ringwear_par.results.stress_variables import stress_coordinates, stress_variables
from ringwear_par.results.variables import Variable, edge_elements, layer_axis

if TYPE_CHECKING:
    import xarray

_BALANCE = "balance_"


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """The last state of a history, with all that it takes to continue.

    Parameters
    ----------
    start : where the history continues.
    pending_iterations : of the contact solver since the last stored state.
    worst : of the history so far, see ``WorstStates.history``.
    """

    start: Start
    pending_iterations: int
    worst: Mapping[str, Sequence[float]]

    @cached_property
    def state(self) -> State:
        """The state, without the axis of histories."""
        return one(self.start.state, 0)

    @cached_property
    def progress(self) -> Progress:
        """Its steps, without the axis of histories."""
        return one(self.start.progress, 0)


@dataclass(frozen=True, eq=False)
class Result(Outcome):
    """A history as it is stored; arrays have the names of its file's variables.

    Parameters
    ----------
    line : the contact elements.
    step : (s,) int, what stored states are called: the steps made, or their own numbers where
        there are times of output, before which a number of steps is not unique.
    steps_made : (s,) int.
    histories : (s,) each, by name, see variables.HISTORIES.
    profiles : (s, n) each, by name, or (n,) where the last ones are stored only, see
        variables.PROFILES; those that the case stores.
    boundary : stored fields on the whole boundaries.
    attributes : of the file: ``case`` (its TOML text), ``title``, ``status``, ``version``, ...
    checkpoint : what a run goes on from, None where the result was made without.
    path : of its file, None for a result in memory.
    parameters : keys of the numbers that there are derivatives with respect to, with their units.
    derivatives : (P, s) or (P, s, n) each, by name, see variables.D_HISTORIES and D_PROFILES;
        (P, n) where the last profiles are stored only.
    layers : of bodies with layers, by name, see variables.LAYERS: (s,), (s, layers + 1) and (s, n),
        or (n,) where the last profiles are stored only.
    stress : stored stresses, None where the case asks for none.
    """

    functions: ClassVar = {
        "summary": "ringwear_par.results.summary", "to_dict": "ringwear_par.results.summary",
        "save": "ringwear_par.results.storage.result_files",
        "plot": "ringwear_par.pictures.figures",
    }  # fmt: skip

    line: ContactLine
    step: IntArray
    steps_made: IntArray
    histories: Mapping[str, Any]
    profiles: Mapping[str, FloatArray]
    boundary: tuple[BoundaryState, ...]
    attributes: Mapping[str, Any]
    checkpoint: Checkpoint | None = None
    path: Path | None = None
    parameters: Mapping[str, str] = field(default_factory=dict)
    derivatives: Mapping[str, FloatArray] = field(default_factory=dict)
    layers: Mapping[str, FloatArray] = field(default_factory=dict)
    stress: StressHistory | None = None

    def __repr__(self) -> str:
        title = self.attributes.get("title") or "no title"
        steps, end = max(self.steps_made, default=0), max(self.histories["time"], default=0.0)
        return (
            f"<Result: {title} ({self.name}): {self.line.n} contact elements, {len(self.step)} "
            f"states of {steps} steps until {end:g} s, {self.attributes['status']}>"
        )

    @property
    def case(self) -> str:
        """The TOML text of the case, as run."""
        return str(self.attributes["case"])

    @property
    def name(self) -> str:
        """What messages call it."""
        return "result in memory" if self.path is None else str(self.path)

    @property
    def balances(self) -> dict[str, float]:
        """Relative defects of balances by name, the worst of all steps (see Balances)."""
        return {
            name.removeprefix(_BALANCE): float(value)
            for name, value in self.attributes.items()
            if name.startswith(_BALANCE)
        }

    @property
    def doubts(self) -> tuple[ValidityWarning, ...]:
        """Warnings about the validity of the answer."""
        return tuple(map(ValidityWarning.of, json.loads(self.attributes["doubts"])))

    @property
    def user_laws(self) -> dict[str, str]:
        """Texts of the users' own laws by body."""
        return dict(json.loads(self.attributes["user_laws"]))

    def summary(self, *, verbose: bool = False) -> str:
        """Return it in a few lines, or all its key numbers and checks, see ``rw.summary``."""
        return str(self.apply("summary", verbose))

    def variables(self) -> list[tuple[Variable, Any]]:
        """Return every variable on the contact line and in time, with its values."""
        numbered = not np.array_equal(self.step, self.steps_made)
        pairs: list[tuple[Variable, Any]] = [
            (table.STATE_NUMBER if numbered else table.STEP, self.step),
            *([(table.STEPS_MADE, self.steps_made)] if numbered else []),
            (table.ELEMENT, np.arange(self.line.n)),
            *((table.HISTORIES[name], values) for name, values in self.histories.items()),
            *((variable, getattr(self.line, name)) for name, variable in table.LINE.items()),
            *((table.PROFILES[name], values) for name, values in self.profiles.items()),
        ]
        if "pressure" in self.profiles:
            edge = edge_elements(self.profiles["pressure"])
            pairs.append((table.EDGE_ELEMENT, edge.astype(table.EDGE_ELEMENT.dtype)))
        pairs += self._layer_variables()
        if self.parameters:
            pairs.append((table.PARAMETER, list(self.parameters)))
            pairs.append((table.PARAMETER_UNIT, list(self.parameters.values())))
        pairs += [(table.DERIVATIVES[name], values) for name, values in self.derivatives.items()]
        if self.stress is not None and self.stress.states:
            pairs += stress_variables(self.stress)
        return [(variable.stored_as(np.ndim(values)), values) for variable, values in pairs]

    def _layer_variables(self) -> list[tuple[Variable, Any]]:
        """Return the variables of layers, with their coordinates."""
        pairs: list[tuple[Variable, Any]] = []
        counts = [self.layers[v].shape[1] if v in self.layers else 0 for v in table.LAYER_VOLUMES]
        for name, values in self.layers.items():
            variable = table.LAYERS[name]
            if name in table.LAYER_VOLUMES:
                layer = layer_axis(list(table.LAYER_VOLUMES).index(name), counts)
                if all(layer != coordinate for coordinate, _ in pairs):
                    pairs.insert(0, (layer, np.arange(values.shape[1])))
                variable = replace(variable, dimensions=("step", layer.name))
            pairs.append((variable, values))
        return pairs

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The names of its coordinates that are no dimensions."""
        names = table.COORDINATES if self.parameters else table.COORDINATES[:-1]
        if self.stress is None or not self.stress.states:
            return names
        return (*names, *stress_coordinates(self.stress))

    def to_xarray(self) -> "xarray.Dataset":
        """Return the dataset that xarray makes of the result's file.

        Raises
        ------
        InputError : xarray is not installed.
        """
        return table.to_dataset(self.variables(), self.attributes, self.coordinates, self.name)


@dataclass(frozen=True)
class FailedResult:
    """A case that could not be computed, among others that could.

    Parameters
    ----------
    case : its TOML text.
    error : why; an InputError or a ComputationError.
    """

    case: str
    error: RingwearError

    def __repr__(self) -> str:
        try:
            title = parse_toml(self.case, "case").get("title")
        except InputError:  # whatever text it was given
            title = None
        return f"<FailedResult: {title or 'no title'}: {type(self.error).__name__}: {self.error}>"


@dataclass(frozen=True, eq=False)
class HistoryColumns:
    """B histories as they are stored, in the order in which their cases were given.

    Stored states of all histories follow each other as rows: those of history i are
    ``offsets[i]`` to ``offsets[i + 1]``. A failed history has the rows before its failure.

    Parameters
    ----------
    offsets : (B + 1,) int.
    steps : (rows,) int, steps made.
    histories : (rows,) each, by name, see ``variables.HISTORIES``.
    profiles : (rows, n) each, by name, see ``variables.PROFILES``; or (B, n), where the last ones
        are stored only: NaN where a history has none.
    imbalance : (B,) float, the worst balance of each, see ``Balances.worst``.
    flags : what makes each doubtful, see ``ValidityWarning.code``.
    seconds : (B,) float, s, that each took: of those that are stepped together, its share.
    status : "done" or "failed".
    reason : why it failed, one line; "" for one that has not.
    derivatives : (P, rows) each, of fields (P, rows, n) or (P, B, n), by name, see
        ``variables.D_HISTORIES`` and ``D_PROFILES``.
    layers : (rows,), (rows, layers + 1), (rows, n) or (B, n) each, by name, see
        ``variables.LAYERS``.
    stress : (rows,) or (rows, points) each, by name, see ``stress_variables.stress_rows``.
    whole : (B,) or (B, points), by name: when wear got through layers, where points are.
    """

    offsets: IntArray
    steps: IntArray
    histories: Mapping[str, Any]
    profiles: Mapping[str, FloatArray]
    imbalance: FloatArray
    flags: tuple[tuple[str, ...], ...]
    seconds: FloatArray
    status: tuple[str, ...]
    reason: tuple[str, ...]
    derivatives: Mapping[str, FloatArray] = field(default_factory=dict)
    layers: Mapping[str, FloatArray] = field(default_factory=dict)
    stress: Mapping[str, FloatArray] = field(default_factory=dict)
    whole: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of the histories."""
        return len(self.status)

    @property
    def deep(self) -> bool:
        """Whether the profiles are stored as often as the histories."""
        return all(len(values) == len(self.steps) for values in self.profiles.values())

    def rows(self, i: int) -> slice:
        """Return which rows are of history i."""
        return slice(int(self.offsets[i]), int(self.offsets[i + 1]))


def balance_attributes(balances: Mapping[str, float]) -> dict[str, float]:
    """Return the attributes that keep balances by name."""
    return {f"{_BALANCE}{name}": value for name, value in balances.items()}
