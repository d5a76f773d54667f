"""Outcomes: data, with doors to what shows and stores them; results of cases, and histories."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.batched import one, take
from ringwear_par.elasticity.mesh import ContactLine
from ringwear_par.elasticity.stress.fields import BoundaryState, StressHistory
from ringwear_par.errors import InputError, RingwearError, ValidityWarning
from ringwear_par.files.text import parse_toml
from ringwear_par.history.state import Progress, Start, State

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

_BALANCE = "balance_"


class Outcome:
    """Data whose summaries, figures and files are made by functions of other modules.

    A class names the modules of these functions, which are loaded when a function is first used:
    no outcome knows any of them.
    """

    #: modules of functions of the outcome, by the functions' names
    functions: ClassVar[Mapping[str, str]]

    def apply(self, name: str, *arguments: Any) -> Any:
        """Return the value of a function of the outcome.

        Raises
        ------
        TypeError : there is no such function of it.
        """
        if name not in self.functions:
            raise TypeError(f"{type(self).__name__}: has no {name}")
        return getattr(import_module(self.functions[name]), name)(self, *arguments)

    def summary(self) -> str:
        """Return a summary in a few lines, as the command prints it. Not collective.

        Raises
        ------
        InputError : a result that was stored without its last state.
        """
        return str(self.apply("summary"))

    def to_dict(self) -> dict[str, Any]:
        """Return its contents as JSON can hold them, for a page or a script. Not collective.

        Raises
        ------
        InputError : a result that was stored without its last state.
        """
        return dict(self.apply("to_dict"))

    def plot(self) -> "Figure":
        """Return its figure."""
        figure: Figure = self.apply("plot")
        return figure

    def report(self, path: str | Path) -> str:
        """Write its page, one HTML file; return what was written, see ``rw.report``."""
        # pages stand on outcomes, which know nothing else of them
        return str(import_module("ringwear_par.reports.report").report(self, path))

    def _repr_html_(self) -> str:
        """Return its summary and figure, for notebooks."""
        return str(import_module("ringwear_par.reports.notebook").outcome_html(self))

    def save(self, path: str | Path) -> None:
        """Write its file, or the files of its folder, which is made.

        Not collective: the process that calls this writes, each file whole.

        Raises
        ------
        InputError : what cannot be written.
        ComputationError : the disk.
        """
        self.apply("save", Path(path))


def summary(outcome: Outcome) -> str:
    """Return an outcome in a few lines, see ``Outcome.summary``.

    Returns
    -------
    str : its lines; of a result penetration, worn volume, wear rate, pressure, torque, checks.
    """
    return _checked(outcome, "summary").summary()


def to_dict(outcome: Outcome) -> dict[str, Any]:
    """Return an outcome as JSON can hold it, see ``Outcome.to_dict``.

    Returns
    -------
    dict : the contents of the outcome's JSON file.
    """
    return _checked(outcome, "to_dict").to_dict()


def save(outcome: Outcome, path: str | Path) -> None:
    """Write an outcome to its file or folder, see ``Outcome.save``."""
    _checked(outcome, "save").save(path)


def _checked(outcome: Outcome, verb: str) -> Outcome:
    if not isinstance(outcome, Outcome):
        raise TypeError(f"{verb}: {type(outcome).__name__}: must be an outcome")
    return outcome


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """The last state of a history, with all that it takes to continue."""

    #: where histories that ended together continue, and which of them this one is
    starts: Start
    place: int
    #: of the contact solver since the last stored state
    pending_iterations: int
    #: of the history so far, see ``WorstStates.history``
    worst: Mapping[str, Sequence[float]]

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields, without the other histories."""
        return {**vars(self), "starts": self.start, "place": 0}

    @cached_property
    def start(self) -> Start:
        """Where the history continues, as of one of B = 1."""
        return take(self.starts, np.array([self.place]))

    @cached_property
    def state(self) -> State:
        """The state, without the axis of histories."""
        return one(self.starts.state, self.place)

    @cached_property
    def progress(self) -> Progress:
        """Its steps, without the axis of histories."""
        return one(self.starts.progress, self.place)


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
    layers : of bodies with layers, by name, see variables.LAYERS: (s,), (s, layers + 1) and (s, n),
        or (n,) where the last profiles are stored only.
    stress : stored stresses, None where the case asks for none.
    """

    functions: ClassVar = {
        "summary": "ringwear_par.results.summary", "to_dict": "ringwear_par.results.summary",
        "save": "ringwear_par.results.storage.result_files",
        "to_xarray": "ringwear_par.results.storage.result_variables",
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

    def to_xarray(self) -> "xarray.Dataset":
        """Return the dataset that xarray makes of the result's file."""
        dataset: xarray.Dataset = self.apply("to_xarray")
        return dataset


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
    """

    #: (B + 1,) int
    offsets: IntArray
    #: (rows,) int, steps made
    steps: IntArray
    #: (rows,) each, by name, see ``variables.HISTORIES``
    histories: Mapping[str, Any]
    #: (rows, n) each, by name, see ``variables.PROFILES``; or (B, n), where the last ones are
    #: stored only: NaN where a history has none
    profiles: Mapping[str, FloatArray]
    #: (B,) float, the worst balance of each, see ``Balances.worst``
    imbalance: FloatArray
    #: what makes each doubtful, see ``ValidityWarning.code``, and limits that ended it early
    flags: tuple[tuple[str, ...], ...]
    #: (B,) float, s, that each took: of those that are stepped together, its share
    seconds: FloatArray
    #: "done" or "failed"
    status: tuple[str, ...]
    #: why it failed, one line; "" for one that has not
    reason: tuple[str, ...]
    #: (rows,), (rows, layers + 1), (rows, n) or (B, n) each, by name, see ``variables.LAYERS``
    layers: Mapping[str, FloatArray] = field(default_factory=dict)
    #: (rows,) or (rows, points) each, by name, see ``result_variables.stress_rows``
    stress: Mapping[str, FloatArray] = field(default_factory=dict)
    #: (B,) or (B, points), by name: when wear got through layers, where points are
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
