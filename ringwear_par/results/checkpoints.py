"""Where a history can go on: its last state and the contact solver's next start."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.batched import one
from ringwear_par.errors import InputError
from ringwear_par.results.variables import Variable

if TYPE_CHECKING:
    import h5py

    from ringwear_par.contact.problem import WarmStart
    from ringwear_par.history.state import Progress, Start, State
    from ringwear_par.results.result import Result

_BODY = Variable("body", ("body",), "1", "0 lower, 1 upper", integer=True)
_ARRAYS = (
    Variable("wear", ("body", "element"), "mm", "wear depth"),
    Variable("worn", ("body",), "mm3", "time integral of the rate of the worn volume"),
    Variable("rates", ("body", "element"), "mm/s", "rate of wear"),
    Variable("error", ("element",), "mm", "estimated error of wear that time steps have made"),
    Variable("shape", ("body", "element"), "mm", "wear depth that the elements have followed"),
    Variable("fit", ("element",), "mm", "what elements are nearer since their slopes turned"),
    Variable("through", ("body",), "s", "when wear first got through all layers, or infinite"),
    Variable("pressure", ("element",), "MPa", "contact pressure"),
    Variable("gap", ("element",), "mm", "gap between the deformed profiles"),
    Variable("warm_scaled_pressure", ("element",), "1", "unknowns of the contact solver"),
)
_NUMBERS = (
    "step", "time", "energy", "iterations", "next_step", "rejected", "assemblies", "approach",
    "force", "pending_iterations", "warm_approach",
)  # fmt: skip
_OF_BODIES = [variable.name for variable in _ARRAYS if variable.dimensions[0] == "body"]
#: attributes that hold the worst of a history
_WORST = "worst_"


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A state to go on from, as files hold it: it is of no use but to ``restored``.

    Parameters
    ----------
    numbers : by name; ``step``, ``time`` (s) and ``pending_iterations``, those of the contact
        solver since the last stored state, among them.
    arrays : by name, over bodies and elements.
    worst : of the history so far, see ``WorstStates.history``.
    """

    numbers: Mapping[str, Any]
    arrays: Mapping[str, FloatArray]
    worst: Mapping[str, Sequence[float]]


def take(
    state: "State",
    progress: "Progress",
    warm: "WarmStart",
    updates: int,
    pending_iterations: int,
    worst: Mapping[str, Sequence[float]],
) -> Checkpoint:
    """Return the checkpoint of a state of one history.

    Parameters
    ----------
    updates : how often the elements were assembled anew to follow the wear.
    pending_iterations : of the contact solver since the last stored state.
    worst : see Checkpoint.
    """
    last, made, start = one(state, 0), one(progress, 0), one(warm, 0)
    contact = last.contact
    numbers = {
        "step": made.steps,
        "time": last.time,
        "energy": last.energy,
        "iterations": made.iterations,
        "next_step": made.next_step,
        "rejected": made.rejected,
        "assemblies": updates,
        "approach": contact.approach,
        "force": contact.force,
        "pending_iterations": pending_iterations,
        "warm_approach": start.approach,
    }
    arrays = {
        "wear": last.wear,
        "worn": last.worn,
        "rates": last.rates,
        "error": last.error,
        "pressure": contact.pressure,
        "gap": contact.gap,
        "warm_scaled_pressure": start.scaled_pressure,
    }
    optional = {"shape": last.meshed_wear, "fit": last.gap_offset, "through": last.through}
    arrays |= {name: values for name, values in optional.items() if values is not None}
    numbers = {name: np.asarray(value).item() for name, value in numbers.items()}
    return Checkpoint(numbers, arrays, worst)


def restored(result: "Result") -> "Start":
    """Return where a stored history goes on.

    Raises
    ------
    InputError : it was stored without.
    """
    from ringwear_par.contact.problem import ContactState, WarmStart
    from ringwear_par.history.state import Progress, Start, State

    if result.checkpoint is None:
        raise InputError(f"{result.name}: holds no state to go on from; must be one of a run")
    numbers, arrays = result.checkpoint.numbers, result.checkpoint.arrays

    def number(name: str, kind: Any = float) -> Any:
        return np.array([numbers[name]], dtype=kind)

    def field(name: str) -> Any:
        """Return values over the elements, of both bodies or of one, as of one of B histories."""
        values = arrays.get(name)
        if values is None:
            return None
        return values[:, None] if name in _OF_BODIES else values[None]

    none = np.zeros(1)
    contact = ContactState(
        field("pressure"), field("gap"), number("approach"), number("force"),
        np.zeros(1, dtype=np.int64), none,
    )  # fmt: skip
    state = State(
        number("time"), field("wear"), field("worn"), number("energy"), contact, field("rates"),
        field("error"), field("shape"), field("fit"), through=field("through"),
    )  # fmt: skip
    progress = replace(
        Progress.at_start(1),
        steps=number("step", np.int64),
        next_step=number("next_step"),
        rejected=number("rejected", np.int64),
        iterations=number("iterations", np.int64),
    )
    warm = WarmStart(field("warm_scaled_pressure"), number("warm_approach"))
    return Start(state, progress, warm, int(numbers["assemblies"]))


def write_checkpoint(group: "h5py.Group", checkpoint: Checkpoint) -> None:
    """Write a checkpoint to a group of a result file, whose elements it has."""
    from ringwear_par.results.hdf5_writing import write_variable

    group.attrs.update(checkpoint.numbers)
    group.attrs.update({f"{_WORST}{name}": values for name, values in checkpoint.worst.items()})
    write_variable(group, _BODY, np.arange(2))
    for variable in _ARRAYS:
        if variable.name in checkpoint.arrays:
            write_variable(group, variable, checkpoint.arrays[variable.name])


def read_checkpoint(group: "h5py.Group", sizes: Mapping[str, int]) -> Checkpoint | None:
    """Return the checkpoint in a group of a result file, None where an older version wrote less.

    Parameters
    ----------
    sizes : of the dimensions of the file.

    Raises
    ------
    Exception : it is damaged, see ``reading``.
    """
    from ringwear_par.history.observers.validity import ENTRIES
    from ringwear_par.results.hdf5_reading import read_array, read_number, read_numbers

    known = {**sizes, "body": 2}
    arrays = {v.name: read_array(group, v, known) for v in _ARRAYS if v.name in group}
    numbers = {name: read_number(group.attrs[name]) for name in _NUMBERS if name in group.attrs}
    needed = {variable.name for variable in _ARRAYS} - {"shape", "fit", "through"}
    if len(numbers) < len(_NUMBERS) or not needed <= arrays.keys():
        return None
    worst = {
        name.removeprefix(_WORST): read_numbers(values)
        for name, values in group.attrs.items()
        if name.startswith(_WORST)
    }
    if any(len(values) != ENTRIES for values in worst.values()):
        raise ValueError(_WORST)
    return Checkpoint(numbers, arrays, worst)
