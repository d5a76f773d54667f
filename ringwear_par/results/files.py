"""Result files: HDF5 with dimension scales, which xarray opens with its h5netcdf engine.

One process writes, to a temporary name beside the target, flushed and synced, then renamed: a file
that is there is whole.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.contact.problem import ContactState, WarmStart
from ringwear_par.elasticity.mesh import ContactLine
from ringwear_par.elasticity.recovery import BODIES, FACES, BoundaryFields, BoundaryState
from ringwear_par.errors import InputError
from ringwear_par.history.model import Balances, State, WearHistory

SOFTWARE = "ringwear-par"

#: variables with dimension (step,): unit and long name
SCALARS = {
    "time": ("s", "time"),
    "approach": ("mm", "downward displacement of the upper ring's top"),
    "penetration": ("mm", "penetration depth: approach since the start"),
    "force": ("N", "axial contact force"),
    "torque": ("N mm", "friction torque"),
    "twist": ("mm", "area mean of the circumferential displacement jump"),
    "worn_volume_lower": ("mm3", "volume lost by the lower ring"),
    "worn_volume_upper": ("mm3", "volume lost by the upper ring"),
    "dissipated_energy": ("N mm", "energy dissipated by friction"),
    "contact_iterations": ("1", "iterations of the contact solver since the last stored step"),
}
#: variables with dimensions (step, element)
ALONG = {
    "pressure": ("MPa", "contact pressure"),
    "gap": ("mm", "gap between the deformed profiles"),
    "wear_lower": ("mm", "wear depth of the lower ring, downward"),
    "wear_upper": ("mm", "wear depth of the upper ring, upward"),
}
#: variables of the groups boundary/lower and boundary/upper by attribute of BoundaryFields: names
#: of their columns, dimension beside time, unit and long name
BOUNDARY = {
    "nodes": (("r", "z"), "node", "mm", "{} of the worn, undeformed body"),
    "displacement": (
        tuple(f"displacement_{x}" for x in ("r", "z", "theta")), "node", "mm",
        "displacement along {}",
    ),
    "traction": (
        tuple(f"traction_{x}" for x in ("r", "z", "theta")), "element", "MPa", "traction along {}",
    ),
    "pressure": (("pressure",), "element", "MPa", "contact pressure, 0 elsewhere"),
    "wear": (("wear",), "element", "mm", "wear depth, 0 off the contact"),
}  # fmt: skip


_APPROACH = list(SCALARS).index("approach")


class Recorder:
    """Stores the states of a history that its case asks for, in memory.

    Parameters
    ----------
    history : the wear history.
    """

    def __init__(self, history: WearHistory) -> None:
        output = history.case.output
        self._history = history
        #: whether the fields are stored as often as the scalars, or at the last stored state only
        self.deep = output.profiles == "all"
        self._steps: list[int] = []
        self._scalars: list[tuple[float, ...]] = []
        self._fields: dict[str, list[FloatArray]] = {name: [] for name in output.fields}
        self._boundary: list[BoundaryState] = []
        self.pending_iterations = 0

    def add(self, state: State) -> None:
        """Take a new state; store it if it is one of those asked for."""
        self.pending_iterations += state.contact.iterations
        if not state.stored:
            return
        history, contact = self._history, state.contact
        volumes = history.worn_volumes(state.wear)
        start = self._scalars[0][_APPROACH] if self._scalars else contact.approach
        values = {
            "time": state.time,
            "approach": contact.approach,
            "penetration": contact.approach - start,
            "force": contact.force,
            "torque": history.torque(contact.pressure),
            "twist": history.twist(contact.pressure),
            "worn_volume_lower": volumes[0],
            "worn_volume_upper": volumes[1],
            "dissipated_energy": state.energy,
            "contact_iterations": self.pending_iterations,
        }
        self._steps.append(state.step)
        self._scalars.append(tuple(values[name] for name in SCALARS))
        along = {
            "pressure": contact.pressure,
            "gap": contact.gap,
            "wear_lower": state.wear[0],
            "wear_upper": state.wear[1],
        }
        for name, rows in self._fields.items():
            if not self.deep:
                rows.clear()
            rows.append(along[name])
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
    def scalars(self) -> dict[str, FloatArray]:
        """(stored,) float each, by name."""
        table = np.array(self._scalars, dtype=float).reshape(-1, len(SCALARS))
        return dict(zip(SCALARS, table.T.copy(), strict=True))

    @property
    def fields(self) -> dict[str, FloatArray]:
        """(stored, n) float each, by name; (1, n) where the last ones are stored only."""
        n = self._history.pair.line.n
        return {name: np.array(rows).reshape(-1, n) for name, rows in self._fields.items()}

    @property
    def boundary(self) -> Sequence[BoundaryState]:
        """Stored fields on the whole boundaries."""
        return self._boundary

    def arrays(self) -> dict[str, FloatArray]:
        """Return what is stored so far by variable, ``step`` (what rows are called) included."""
        line, fields = self._history.pair.line, self.fields
        if not self.stored:
            fields = {}
        elif not self.deep:
            fields = {name: table[0] for name, table in fields.items()}
        return {
            "step": self.rows.astype(float),
            **self.scalars,
            "r": line.r,
            "width": line.width,
            **fields,
        }

    def restore(self, checkpoint: "Checkpoint") -> None:
        """Put the stored rows of an interrupted run back, as far as the case still stores them."""
        steps, times = checkpoint.steps, checkpoint.scalars["time"]
        # the last one of a shorter run may not belong here
        stores = self._history.stores
        keep = np.array([stores(int(n), float(t)) for n, t in zip(steps, times, strict=True)])
        self._steps = steps[keep].tolist()
        table = np.array([checkpoint.scalars[name][keep] for name in SCALARS])
        self._scalars = list(map(tuple, table.T.tolist()))
        for name in self._fields:
            stored = checkpoint.fields[name]
            self._fields[name] = list(stored[keep] if self.deep else stored[None])
        # the last state of a shorter run is not the last one of this run
        last = self._history.case.output.boundary == "last"
        if not last or self._history.finished(checkpoint.state):
            left = set(times[keep].tolist())
            self._boundary = [b for b in checkpoint.boundary if b.time in left]
        self.pending_iterations = checkpoint.pending_iterations + int(
            checkpoint.scalars["contact_iterations"][~keep].sum()
        )


@dataclass(frozen=True)
class Checkpoint:
    """An interrupted run, as its file holds it."""

    state: State
    warm: WarmStart
    steps: IntArray
    scalars: dict[str, FloatArray]
    fields: dict[str, FloatArray]
    boundary: tuple[BoundaryState, ...]
    pending_iterations: int
    seconds: dict[str, float]
    user_laws: dict[str, str]


@dataclass(frozen=True)
class Result:
    """A stored history, for plots: arrays as in the file, and its attributes."""

    path: Path
    scalars: dict[str, FloatArray]
    fields: dict[str, FloatArray]
    line: ContactLine
    steps: IntArray
    boundary: tuple[BoundaryState, ...]
    attributes: dict[str, Any]


def write_result(
    path: Path,
    case: Case,
    line: ContactLine,
    recorder: Recorder,
    state: State,
    warm: WarmStart,
    attributes: Mapping[str, Any],
) -> None:
    """Write a result file, complete or not, by rename. Call on one rank only.

    Raises
    ------
    OSError : the disk or the folder.
    """
    temporary = path.with_name(f"{path.name}.tmp{os.getpid()}")
    try:
        with h5py.File(temporary, "w") as file:
            _write_history(file, line, recorder)
            if recorder.boundary:
                for i, name in enumerate(BODIES):
                    _write_boundary(file.create_group(f"boundary/{name}"), recorder.boundary, i)
            _write_checkpoint(file.create_group("checkpoint"), line, recorder, state, warm)
            file.attrs.update(
                {
                    "software": SOFTWARE,
                    "case": case.text,
                    "title": case.title,
                    "coordinates": "time r width",
                    **attributes,
                }
            )
            file.flush()
        with temporary.open("rb+") as handle:
            os.fsync(handle.fileno())
        temporary.replace(path)
    except RuntimeError as error:  # what h5py makes of some failures of the disk
        temporary.unlink(missing_ok=True)
        raise OSError(None, str(error), str(path)) from error
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _variable(
    group: h5py.Group, name: str, data: FloatArray | IntArray, dims: tuple[str, ...], unit: str,
    text: str,
) -> None:  # fmt: skip
    """Write a variable over dimensions of its group."""
    dataset = group.create_dataset(name, data=data)
    dataset.attrs["units"], dataset.attrs["long_name"] = unit, text
    for axis, dim in enumerate(dims):
        dataset.dims[axis].attach_scale(group[dim])


def _dimension(
    group: h5py.Group, name: str, data: FloatArray | IntArray, unit: str, text: str
) -> None:
    """Write a coordinate that is a dimension of its group."""
    _variable(group, name, data, (), unit, text)
    group[name].make_scale(name)


def _write_history(file: h5py.File, line: ContactLine, recorder: Recorder) -> None:
    made = "number of time steps made"
    timed = not np.array_equal(recorder.rows, recorder.steps)
    _dimension(file, "step", recorder.rows, "1", "number of the stored state" if timed else made)
    if timed:
        _variable(file, "steps_made", recorder.steps, ("step",), "1", made)
    text = "contact element, from the inner edge outwards"
    _dimension(file, "element", np.arange(line.n), "1", text)
    for name, table in recorder.scalars.items():
        whole = name == "contact_iterations"
        _variable(file, name, table.astype(int) if whole else table, ("step",), *SCALARS[name])
    _variable(file, "r", line.r, ("element",), "mm", "radius of the element's mid-point")
    _variable(file, "width", line.width, ("element",), "mm", "radial length of the element")
    for name, table in recorder.fields.items():
        unit, text = ALONG[name]
        if recorder.deep:
            _variable(file, name, table, ("step", "element"), unit, text)
        elif len(table):
            _variable(file, name, table[0], ("element",), unit, f"{text}, at the last step")


def _write_boundary(group: h5py.Group, states: Sequence[BoundaryState], body: int) -> None:
    """Write the fields on the boundary of one body, 0 or 1, at all stored times."""
    fields = [state.bodies[body] for state in states]
    first = fields[0]
    nodes, elements = np.arange(len(first.nodes)), np.arange(len(first.elements))
    _dimension(group, "time", np.array([state.time for state in states]), "s", "time")
    _dimension(group, "node", nodes, "1", "node of the boundary")
    text = "element of the boundary; its outward normal lies to the right of its direction"
    _dimension(group, "element", elements, "1", text)
    _dimension(group, "corner", np.arange(3), "1", "first, middle and last node of an element")
    steps = np.array([state.step for state in states])
    _variable(group, "step", steps, ("time",), "1", "number of time steps made")
    text = "nodes of the element"
    _variable(group, "nodes", first.elements, ("element", "corner"), "1", text)
    faces = ", ".join(f"{number} {name}" for number, name in enumerate(FACES))
    _variable(group, "face", first.face, ("element",), "1", f"face of the body: {faces}")
    for attribute, (names, dim, unit, text) in BOUNDARY.items():
        table = np.array([getattr(f, attribute) for f in fields])
        columns = table.reshape(*table.shape[:2], len(names))
        for column, name in enumerate(names):
            told = text.format(name.rpartition("_")[2])
            _variable(group, name, columns[..., column], ("time", dim), unit, told)


def _read_boundary(file: h5py.File) -> tuple[BoundaryState, ...]:
    """Return the stored fields on the boundaries, () where there are none."""
    if "boundary" not in file:
        return ()
    group = file["boundary"][BODIES[0]]
    steps, times = group["step"][:].tolist(), group["time"][:].tolist()
    both = [_read_body(file["boundary"][name]) for name in BODIES]
    return tuple(
        BoundaryState(step, time, (lower, upper))
        for step, time, lower, upper in zip(steps, times, *both, strict=True)
    )


def _read_body(group: h5py.Group) -> list[BoundaryFields]:
    elements, face = group["nodes"][:], group["face"][:]
    table = {
        attribute: np.stack([group[name][:] for name in names], axis=-1)
        for attribute, (names, *_) in BOUNDARY.items()
    }
    return [
        BoundaryFields(
            table["nodes"][t], elements, face, table["displacement"][t], table["traction"][t],
            table["pressure"][t, :, 0], table["wear"][t, :, 0],
        )
        for t in range(len(group["time"]))
    ]  # fmt: skip


def _write_checkpoint(
    group: h5py.Group, line: ContactLine, recorder: Recorder, state: State, warm: WarmStart
) -> None:
    for name in ("step", "time", "energy", "iterations", "next_step", "rejected", "assemblies"):
        group.attrs[name] = getattr(state, name)
    group.attrs["approach"] = state.contact.approach
    group.attrs["force"] = state.contact.force
    group.attrs["balances"] = state.balances.values()
    group.attrs["pending_iterations"] = recorder.pending_iterations
    group.attrs["warm_approach"], group.attrs["warm_force"] = warm.approach, warm.force
    if state.shape is not None:
        group.create_dataset("shape", data=state.shape)
    for name, values in (
        ("edges", line.edges), ("wear", state.wear), ("worn", state.worn),
        ("pressure", state.contact.pressure), ("gap", state.contact.gap),
        ("warm_scaled_pressure", warm.scaled_pressure), ("warm_rate", warm.rate),
        ("warm_gap", warm.gap),
    ):  # fmt: skip
        group.create_dataset(name, data=values)


def read_status(path: Path) -> tuple[str, int] | None:
    """Return status and last step of a result file, None if there is none. Not collective.

    Raises
    ------
    InputError : something else is there.
    """
    if not path.exists():
        return None
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("software") == SOFTWARE:
                return str(file.attrs["status"]), int(file["checkpoint"].attrs["step"])
    except (OSError, KeyError):
        pass
    raise InputError(
        f"{path}: exists and is not a result file of ringwear, or is damaged; must be a new name "
        "or such a file"
    )


def read_checkpoint(path: Path) -> tuple[str, Checkpoint]:
    """Return the case text and the checkpoint of a result file. Not collective."""
    with h5py.File(path, "r") as file:
        group = file["checkpoint"]
        attrs = group.attrs
        contact = ContactState(
            group["pressure"][:], group["gap"][:], float(attrs["approach"]),
            float(attrs["force"]), 0, 0.0,
        )  # fmt: skip
        time, last = float(attrs["time"]), float(file["time"][-1])
        state = State(
            int(attrs["step"]), time, group["wear"][:], group["worn"][:],
            float(attrs["energy"]), contact, Balances(*(float(v) for v in attrs["balances"])),
            int(attrs["iterations"]), float(attrs["next_step"]), int(attrs["rejected"]),
            group["shape"][:] if "shape" in group else None, int(attrs["assemblies"]),
            stored=last == time, stored_before=last,
        )  # fmt: skip
        warm = WarmStart(
            group["warm_scaled_pressure"][:], group["warm_rate"][:], group["warm_gap"][:],
            float(attrs["warm_approach"]), float(attrs["warm_force"]),
        )  # fmt: skip
        return str(file.attrs["case"]), Checkpoint(
            state,
            warm,
            file["steps_made" if "steps_made" in file else "step"][:],
            {name: file[name][:] for name in SCALARS},
            {name: file[name][:] for name in ALONG if name in file},
            _read_boundary(file),
            int(attrs["pending_iterations"]),
            {k: float(v) for k, v in file.attrs.items() if k.startswith("seconds_")},
            json.loads(str(file.attrs["user_laws"])) if "user_laws" in file.attrs else {},
        )


def read_result(path: Path) -> Result:
    """Read a result file. Not collective.

    Raises
    ------
    InputError : it is not one.
    """
    if not path.exists():
        raise InputError(f"{path}: does not exist; must be a result file of ringwear")
    try:
        read_status(path)
    except InputError as error:
        raise InputError(f"{path}: is not a result file of ringwear, or is damaged") from error
    with h5py.File(path, "r") as file:
        return Result(
            path,
            {name: file[name][:] for name in SCALARS},
            {name: file[name][:] for name in ALONG if name in file},
            ContactLine(file["checkpoint/edges"][:]),
            file["step"][:],
            _read_boundary(file),
            dict(file.attrs),
        )
