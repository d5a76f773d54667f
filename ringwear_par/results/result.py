"""Results of cases and their attributes, and what all outcomes show; histories as columns."""

import base64
import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.files.law_trials import law_sources
from ringwear_par.cases.law import in_words
from ringwear_par.cases.units import with_signs
from ringwear_par.elasticity.mesh import ContactLine
from ringwear_par.elasticity.sections import BODIES, BodyName
from ringwear_par.elasticity.stress.fields import MESH_FIELDS, BoundaryFields, BoundaryState
from ringwear_par.errors import ComputationError, RingwearError, ValidityWarning
from ringwear_par.files.writing import check_writable
from ringwear_par.history.state import State
from ringwear_par.results.variables import HISTORIES, LAYERS, PROFILES, STRESSES, TIMES_THROUGH
from ringwear_par.schedules import Table, in_time, mean, points_of
from ringwear_par.version import versions

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

#: beginning of the attributes of balances
BALANCE = "balance_"


class Outcome:
    """What all outcomes show: a page, and in notebooks their summary and figure."""

    def summary(self) -> str:
        """Return a summary in a few lines, as the command prints it."""
        raise NotImplementedError

    def plot(self) -> "Figure":
        """Return its figure."""
        raise NotImplementedError

    def save(self, path: str | Path) -> None:
        """Write its file, or the files of its folder, which is made; each whole, by this process.

        Raises
        ------
        InputError : what cannot be written.
        ComputationError : the disk.
        """
        raise NotImplementedError

    def report(self, path: str | Path) -> str:
        """Write its page, one HTML file; return what was written, see ``rw.report``."""
        from ringwear_par import report

        return report(self, path)

    def _repr_html_(self) -> str:
        """Return its summary and figure, for notebooks, as far as it holds enough for them."""
        text, drawn = repr(self), ""
        with suppress(RingwearError):
            text = self.summary()
        with suppress(RingwearError):
            picture, size = self.plot()._repr_png_()  # type: ignore[attr-defined]
            address = f"data:image/png;base64,{base64.b64encode(picture).decode()}"
            drawn = f'<img src="{address}" width="{size["width"]}" alt="its figure">'
        return f'<pre style="white-space: pre-wrap">{escape(with_signs(text))}</pre>{drawn}'


class Checkpoint(NamedTuple):
    """Where a history goes on: its last state, as of a block of one, and its worst measures."""

    state: State
    #: of the history so far, see ``checks.Worst``
    worst: Mapping[str, FloatArray]


@dataclass(frozen=True, eq=False)
class Result(Outcome):
    """A history as it is stored.

    Parameters
    ----------
    data : arrays by their names in ``variables.VARIABLES``, which has their axes, units and
        meanings; fields along the contact line may lack the axis of steps: those of the last.
    attributes : of the file: ``case`` (its TOML text), ``title``, ``status``, ``version``, ...
    checkpoint : what a run goes on from.
    path : of its file, None for a result in memory.
    """

    data: Mapping[str, Any]
    attributes: Mapping[str, Any]
    checkpoint: Checkpoint
    path: Path | None = None

    def __repr__(self) -> str:
        title = self.attributes.get("title") or "no title"
        steps, end = max(self.step, default=0), max(self.histories["time"], default=0.0)
        return (
            f"<Result: {title} ({self.name}): {self.line.n} contact elements, {len(self.step)} "
            f"states of {steps} steps until {end:g} s, {self.attributes['status']}>"
        )

    def _some(self, names: Iterable[str]) -> dict[str, Any]:
        return {name: self.data[name] for name in names if name in self.data}

    @property
    def line(self) -> ContactLine:
        """The contact elements."""
        return ContactLine(self.data["line/edges"])

    @property
    def step(self) -> IntArray:
        """(s,) number of steps made before each stored state."""
        return self.data["step"]

    @property
    def last_state(self) -> State:
        """The state that a run goes on from, as of a block of one."""
        return self.checkpoint.state

    @property
    def histories(self) -> dict[str, Any]:
        """(s,) each, by name, see ``variables.HISTORIES``."""
        return self._some(HISTORIES)

    @property
    def profiles(self) -> dict[str, FloatArray]:
        """(s, n) each of the stored ones, or (n,) of the last, see ``variables.PROFILES``."""
        return self._some(PROFILES)

    @property
    def layers(self) -> dict[str, FloatArray]:
        """Of bodies with layers: (s,), (s, layers + 1), (s, n) or (n,), see ``LAYERS``."""
        return self._some(LAYERS)

    @property
    def stress(self) -> dict[str, Any]:
        """Stored stresses, and where they are, by name, see ``variables.STRESSES``."""
        return self._some(STRESSES)

    @property
    def boundary(self) -> tuple[BoundaryState, ...]:
        """Stored fields on the whole boundaries, () where there are none."""
        names, data = [field.name for field in fields(BoundaryFields)], self.data

        def of(body: BodyName, t: int) -> BoundaryFields:
            arrays = {name: data[f"boundary/{body}/{name}"] for name in names}
            return BoundaryFields(**{n: v if n in MESH_FIELDS else v[t] for n, v in arrays.items()})

        times, steps = (data.get(f"boundary/lower/{name}", ()) for name in ("time", "steps_made"))
        return tuple(
            BoundaryState(int(step), float(time), (of("lower", t), of("upper", t)))
            for t, (step, time) in enumerate(zip(steps, times, strict=True))
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
        """Relative defects of balances by name, the worst of all steps, see ``checks.BALANCES``."""
        return {
            name.removeprefix(BALANCE): float(value)
            for name, value in self.attributes.items()
            if name.startswith(BALANCE)
        }

    @property
    def doubts(self) -> tuple[ValidityWarning, ...]:
        """Warnings about the validity of the answer."""
        return tuple(map(ValidityWarning.of, json.loads(self.attributes["doubts"])))

    @property
    def user_laws(self) -> dict[str, str]:
        """Texts of the users' own laws by body."""
        return dict(json.loads(self.attributes["user_laws"]))

    def summary(self) -> str:
        """Return it in a few lines, as ``ringwear run`` prints it."""
        from ringwear_par.results.key_numbers import summary

        return summary(self)

    def to_dict(self) -> dict[str, Any]:
        """Return title, status, warnings and key numbers with their units, for JSON."""
        from ringwear_par.results.key_numbers import to_dict

        return to_dict(self)

    def to_xarray(self) -> "xarray.Dataset":
        """Return the dataset that xarray makes of the result's file."""
        from ringwear_par.results.files import to_xarray

        return to_xarray(self)

    def save(self, path: str | Path) -> None:
        """Write its file, see ``Outcome.save``."""
        from ringwear_par.results.files import write_result

        check_writable(Path(path))
        try:
            write_result(Path(path), self)
        except OSError as error:
            raise ComputationError(f"{path}: {error.strerror or error}") from error

    def plot(self) -> "Figure":
        """Return the figure of its histories and profiles."""
        from ringwear_par import plot

        return plot(self)


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
        return f"<FailedResult: {type(self.error).__name__}: {self.error}>"


@dataclass(frozen=True, eq=False)
class HistoryColumns:
    """B histories as they are stored, in the order in which their cases were given.

    Stored states of all histories follow each other as rows: those of history i are
    ``offsets[i]`` to ``offsets[i + 1]``. A failed history has the rows before its failure.
    """

    #: (B + 1,) int
    offsets: IntArray
    #: (rows, ...) each, by name, see ``variables``
    data: Mapping[str, Any]
    #: (B, ...) each, by name: numbers and, where they are stored alone, profiles at the ends; when
    #: wear got through layers; where points of stress are
    whole: Mapping[str, FloatArray]
    #: (B,) float, the worst balance of each, see ``Worst.imbalance``
    imbalance: FloatArray
    #: what makes each doubtful, see ``ValidityWarning.code``, and limits that ended it early
    flags: tuple[tuple[str, ...], ...]
    #: (B,) float, s, that each took: of those that are stepped together, its share
    seconds: FloatArray
    #: "done" or "failed"
    status: tuple[str, ...]
    #: why it failed, one line; "" for one that has not
    reason: tuple[str, ...]


# -- attributes ------------------------------------------------------------------------------------


def case_attributes(case: Case, time: float) -> dict[str, Any]:
    """Return the attributes of a case whose history has come to a time (s)."""
    about: dict[str, Any] = {
        "case": case.stored_text,
        "title": case.title,
        **versions(),
        "scheme": case.time.scheme,
        "time_step": case.time.step,
        "time_steps": case.time.steps,
        "time_end": case.time.end,
        "friction": mean(case.friction, 0.0, time or case.time.end),  # so far
        "nominal_area": case.area,  # mm2
        "mean_radius": case.mean_radius,  # mm
        "omega": in_time(case.load.omega, time),  # rad/s
        "user_laws": json.dumps(law_sources(case)),
        # whether worn volume is a constant times the friction energy, by layer, of a body
        "energy_identity": int(
            any(all(law.ratio(case.friction) for law in of) for of in case.laws if of)
        ),
    }
    for name, quantity in (("friction", case.friction), ("omega", case.load.omega)):
        if isinstance(quantity, Table):  # as texts: other attributes of HDF5 have room for 64 kB
            about[f"{name}_table"] = json.dumps(points_of(quantity))
    for body, ring, section, laws in zip(BODIES, case.rings, case.sections, case.laws, strict=True):
        *layers, itself = np.array(ring.densities, dtype=float).tolist()  # g/mm3, or NaN
        if not np.isnan(itself):
            about[f"density_{body}"] = itself
        if not np.isnan(layers).all():
            about[f"density_{body}_layers"] = tuple(layers)
        if section.face:
            about[f"face_{body}"] = section.face_description
        about[f"law_{body}"] = in_words(laws, [layer.thickness for layer in ring.layers])
    return about


def times_through(case: Case, through: FloatArray) -> dict[str, FloatArray]:
    """Return when wear first got through the layers of each body that has some, s or NaN.

    Parameters
    ----------
    through : (2, ...) s, see ``State``.
    """
    return {
        name: np.where(np.isfinite(time), time, np.nan)
        for name, time, ring in zip(TIMES_THROUGH, through, case.rings, strict=True)
        if ring.layers
    }
