"""Where a history can go on: its last state and the contact solver's next start."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import h5py
import numpy as np

from ringwear_par.batched import one
from ringwear_par.contact.problem import ContactState, WarmStart
from ringwear_par.errors import InputError
from ringwear_par.history.observers.worst_states import ENTRIES
from ringwear_par.history.state import Progress, Start, State
from ringwear_par.results.result import Checkpoint, Result
from ringwear_par.results.storage.hdf5 import read_array, read_number, read_numbers, write_variable
from ringwear_par.results.variables import Variable

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
    "force", "pending_iterations", "warm_approach", "interface",
)  # fmt: skip
#: of histories whose elements follow the wear, and of bodies with layers
_OPTIONAL = ("shape", "fit", "through")
_OF_BODIES = [variable.name for variable in _ARRAYS if variable.dimensions[0] == "body"]
#: attributes that hold the worst of a history
_WORST = "worst_"


def take(
    state: State,
    progress: Progress,
    warm: WarmStart,
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
    last, steps, start = one(state, 0), one(progress, 0), one(warm, 0)
    contact = last.contact
    numbers = {
        "step": steps.steps,
        "time": last.time,
        "energy": last.energy,
        "iterations": steps.iterations,
        "next_step": steps.next_step,
        "rejected": steps.rejected,
        "interface": steps.interface,
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


def restored(result: Result) -> Start:
    """Return where a stored history goes on.

    Raises
    ------
    InputError : it was stored without.
    """
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
        interface=number("interface"),
        rejected=number("rejected", np.int64),
        iterations=number("iterations", np.int64),
    )
    warm = WarmStart(field("warm_scaled_pressure"), number("warm_approach"))
    return Start(state, progress, warm, int(numbers["assemblies"]))


def write_checkpoint(group: h5py.Group, checkpoint: Checkpoint) -> None:
    """Write a checkpoint to a group of a result file, whose elements it has."""
    group.attrs.update(checkpoint.numbers)
    group.attrs.update({f"{_WORST}{name}": values for name, values in checkpoint.worst.items()})
    write_variable(group, _BODY, np.arange(2))
    for variable in _ARRAYS:
        if variable.name in checkpoint.arrays:
            write_variable(group, variable, checkpoint.arrays[variable.name])


def read_checkpoint(group: h5py.Group, sizes: Mapping[str, int]) -> Checkpoint:
    """Return the checkpoint in a group of a result file.

    Parameters
    ----------
    sizes : of the dimensions of the file.

    Raises
    ------
    Exception : it is damaged, see ``reading``.
    """
    known = {**sizes, "body": 2}
    arrays = {
        variable.name: read_array(group, variable, known)
        for variable in _ARRAYS
        if variable.name in group or variable.name not in _OPTIONAL
    }
    numbers = {name: read_number(group.attrs[name]) for name in _NUMBERS}
    worst = {
        name.removeprefix(_WORST): read_numbers(values)
        for name, values in group.attrs.items()
        if name.startswith(_WORST)
    }
    if any(len(values) != ENTRIES for values in worst.values()):
        raise ValueError(_WORST)
    return Checkpoint(numbers, arrays, worst)
