"""Result files: HDF5 with dimension scales, which xarray opens with its h5netcdf engine.

One process writes, to a temporary name beside the target, flushed and synced, then renamed: a file
that is there is whole.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.case import Case
from ringwear_par.contact import ContactState, WarmStart
from ringwear_par.errors import InputError
from ringwear_par.geometry import ContactLine, FloatArray, IntArray
from ringwear_par.history import Balances, State, WearHistory

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
        self.pending_iterations = 0

    @property
    def stored(self) -> int:
        """Number of stored states."""
        return len(self._steps)

    @property
    def steps(self) -> IntArray:
        """(stored,) int, numbers of steps made."""
        return np.array(self._steps, dtype=np.int64)

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

    def arrays(self) -> dict[str, FloatArray]:
        """Return what is stored so far by variable, ``step`` (the numbers of steps) included."""
        line, fields = self._history.pair.line, self.fields
        if not self.stored:
            fields = {}
        elif not self.deep:
            fields = {name: table[0] for name, table in fields.items()}
        return {
            "step": self.steps.astype(float),
            **self.scalars,
            "r": line.r,
            "width": line.width,
            **fields,
        }

    def restore(self, checkpoint: "Checkpoint") -> None:
        """Put the stored rows of an interrupted run back, as far as the case still stores them."""
        output, adaptive = self._history.case.output, self._history.case.time.adaptive
        steps = checkpoint.steps
        keep = np.ones(len(steps), dtype=bool)
        if not (output.times or adaptive):  # the last one of a shorter run may not belong here
            keep = (steps % output.every == 0) | (steps == self._history.case.time.steps)
        self._steps = steps[keep].tolist()
        table = np.array([checkpoint.scalars[name][keep] for name in SCALARS])
        self._scalars = list(map(tuple, table.T.tolist()))
        for name in self._fields:
            stored = checkpoint.fields[name]
            self._fields[name] = list(stored[keep] if self.deep else stored[None])
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
    pending_iterations: int
    seconds: dict[str, float]


@dataclass(frozen=True)
class Result:
    """A stored history, for plots: arrays as in the file, and its attributes."""

    path: Path
    scalars: dict[str, FloatArray]
    fields: dict[str, FloatArray]
    line: ContactLine
    steps: IntArray
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
            _write_checkpoint(file.create_group("checkpoint"), line, recorder, state, warm)
            file.attrs.update(
                {"software": SOFTWARE, "case": case.text, "title": case.title, **attributes}
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


def _write_history(file: h5py.File, line: ContactLine, recorder: Recorder) -> None:
    def variable(
        name: str, data: FloatArray | IntArray, dims: tuple[str, ...], unit: str, text: str
    ) -> None:
        dataset = file.create_dataset(name, data=data)
        dataset.attrs["units"], dataset.attrs["long_name"] = unit, text
        for axis, dim in enumerate(dims):
            dataset.dims[axis].attach_scale(file[dim])

    for name, data, text in (
        ("step", recorder.steps, "number of time steps made"),
        ("element", np.arange(line.n), "contact element, from the inner edge outwards"),
    ):
        variable(name, data, (), "1", text)
        file[name].make_scale(name)
    for name, table in recorder.scalars.items():
        whole = name == "contact_iterations"
        variable(name, table.astype(int) if whole else table, ("step",), *SCALARS[name])
    variable("r", line.r, ("element",), "mm", "radius of the element's mid-point")
    variable("width", line.width, ("element",), "mm", "radial length of the element")
    for name, table in recorder.fields.items():
        unit, text = ALONG[name]
        if recorder.deep:
            variable(name, table, ("step", "element"), unit, text)
        elif len(table):
            variable(name, table[0], ("element",), unit, f"{text}, at the last step")


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
        state = State(
            int(attrs["step"]), float(attrs["time"]), group["wear"][:], group["worn"][:],
            float(attrs["energy"]), contact, Balances(*(float(v) for v in attrs["balances"])),
            int(attrs["iterations"]), float(attrs["next_step"]), int(attrs["rejected"]),
            group["shape"][:] if "shape" in group else None, int(attrs["assemblies"]),
        )  # fmt: skip
        warm = WarmStart(
            group["warm_scaled_pressure"][:], group["warm_rate"][:], group["warm_gap"][:],
            float(attrs["warm_approach"]), float(attrs["warm_force"]),
        )  # fmt: skip
        return str(file.attrs["case"]), Checkpoint(
            state,
            warm,
            file["step"][:],
            {name: file[name][:] for name in SCALARS},
            {name: file[name][:] for name in ALONG if name in file},
            int(attrs["pending_iterations"]),
            {k: float(v) for k, v in file.attrs.items() if k.startswith("seconds_")},
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
            dict(file.attrs),
        )
