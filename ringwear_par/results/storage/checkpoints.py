"""Where a history continues: its last state and the contact solver's next start, as files hold it.

One table says which part of a ``Checkpoint`` each variable of a file is.
"""

from collections.abc import Mapping
from dataclasses import replace
from operator import attrgetter
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
#: parts of a ``Start`` that are arrays
_ARRAYS = {
    "state.wear": Variable("wear", ("body", "element"), "mm", "wear depth"),
    "state.worn": Variable(
        "worn", ("body",), "mm3", "time integral of the rate of the worn volume"
    ),
    "state.rates": Variable("rates", ("body", "element"), "mm/s", "rate of wear"),
    "state.error": Variable(
        "error", ("element",), "mm", "estimated error of wear that time steps have made"
    ),
    "state.meshed_wear": Variable(
        "shape", ("body", "element"), "mm", "wear depth that the elements have followed"
    ),
    "state.gap_offset": Variable(
        "fit", ("element",), "mm", "what elements are nearer since their slopes turned"
    ),
    "state.through": Variable(
        "through", ("body",), "s", "when wear first got through all layers, or infinite"
    ),
    "state.contact.pressure": Variable("pressure", ("element",), "MPa", "contact pressure"),
    "state.contact.gap": Variable("gap", ("element",), "mm", "gap between the deformed profiles"),
    "warm.scaled_pressure": Variable(
        "warm_scaled_pressure", ("element",), "1", "unknowns of the contact solver"
    ),
}
#: of histories whose elements follow the wear, and of bodies with layers
_OPTIONAL = ("state.meshed_wear", "state.gap_offset", "state.through")
#: parts that are numbers: their names in files, and their types
_NUMBERS: dict[str, tuple[str, type]] = {
    "progress.steps": ("step", int),
    "state.time": ("time", float),
    "state.energy": ("energy", float),
    "progress.iterations": ("iterations", int),
    "progress.next_step": ("next_step", float),
    "progress.rejected": ("rejected", int),
    "progress.interface": ("interface", float),
    "updates": ("assemblies", int),
    "state.contact.approach": ("approach", float),
    "state.contact.force": ("force", float),
    "warm.approach": ("warm_approach", float),
}
#: other attributes: a number, and the beginning of those that hold the worst of a history
_PENDING, _WORST = "pending_iterations", "worst_"


def restored(result: Result) -> Start:
    """Return where a stored history continues.

    Raises
    ------
    InputError : it was stored without.
    """
    if result.checkpoint is None:
        raise InputError(f"{result.name}: holds no state to go on from; must be one of a run")
    return result.checkpoint.start


def write_checkpoint(group: h5py.Group, checkpoint: Checkpoint) -> None:
    """Write a checkpoint to a group of a result file, whose elements it has."""
    start = one(checkpoint.start, 0)
    group.attrs.update({name: attrgetter(part)(start) for part, (name, _) in _NUMBERS.items()})
    group.attrs[_PENDING] = checkpoint.pending_iterations
    group.attrs.update({f"{_WORST}{name}": values for name, values in checkpoint.worst.items()})
    write_variable(group, _BODY, np.arange(2))
    for part, variable in _ARRAYS.items():
        values = attrgetter(part)(start)
        if values is not None:
            write_variable(group, variable, values)


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
    parts: dict[str, Any] = {
        part: np.array([read_number(group.attrs[name])], dtype=kind)
        for part, (name, kind) in _NUMBERS.items()
    }
    for part, variable in _ARRAYS.items():
        if variable.name in group or part not in _OPTIONAL:
            histories = (
                variable.dimensions.index("body") + 1 if "body" in variable.dimensions else 0
            )
            parts[part] = np.expand_dims(read_array(group, variable, known), histories)
    worst = {
        name.removeprefix(_WORST): read_numbers(values)
        for name, values in group.attrs.items()
        if name.startswith(_WORST)
    }
    if any(len(values) != ENTRIES for values in worst.values()):
        raise ValueError(_WORST)
    return Checkpoint(_start(parts), int(read_number(group.attrs[_PENDING])), worst)


def _start(parts: Mapping[str, Any]) -> Start:
    """Return the start of these parts, of which it has no others."""

    def of(owner: str) -> dict[str, Any]:
        """Return the parts of an owner by their names in it."""
        paths = {part: part.rpartition(".") for part in parts}
        return {name: parts[part] for part, (table, _, name) in paths.items() if table == owner}

    zero = np.zeros(1, dtype=np.int64)
    contact = ContactState(**of("state.contact"), iterations=zero, residual=np.zeros(1))
    state = State(**of("state"), contact=contact)
    progress = replace(Progress.at_start(1), **of("progress"))
    return Start(state, progress, WarmStart(**of("warm")), int(parts["updates"][0]))
