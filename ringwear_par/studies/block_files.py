"""The arrays of a block: padded to (cases, ...), and its file, which is there whole or not."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.arrays import IntArray
from ringwear_par.errors import InputError, reason_of
from ringwear_par.results.hdf5 import UnreadableError, atomic_hdf5, reading
from ringwear_par.results.variables import LINE
from ringwear_par.studies.ensemble import SOFTWARE, join_flags
from ringwear_par.studies.stored_variables import FIELDS, STORED, has_layers
from ringwear_par.studies.together import Computed
from ringwear_par.version import __version__

FILE_KIND = "a block of a sweep"
#: how variables are compressed
PACKED = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
#: share of padding above which they are compressed in a block, too, which is gone once it is merged
_MUCH_PADDING = 0.25


def arrays_of(
    cases: Sequence[Any],
    parts: Sequence[tuple[IntArray, Computed]],
    errors: Mapping[int, Exception],
) -> dict[str, Any]:
    """Return what is stored of cases but their names: those of parts, and those without."""
    count = len(cases)
    status, flags = ["failed"] * count, [""] * count
    reasons = [reason_of(errors[i]) if i in errors else "" for i in range(count)]
    arrays: dict[str, Any] = {
        "steps_stored": np.zeros(count, dtype=np.int64),
        "elements": np.zeros(count, dtype=np.int64),
        "seconds": np.zeros(count), "imbalance": np.zeros(count),
    }  # fmt: skip
    tables: list[tuple[IntArray, dict[str, Any]]] = []
    for at, part in parts:
        columns = part.columns
        rows, line = np.diff(columns.offsets), cases[at[0]].line
        for i, place in enumerate(at.tolist()):
            status[place], reasons[place] = columns.status[i], columns.reason[i]
            flags[place] = join_flags(columns.flags[i])
        arrays["steps_stored"][at], arrays["elements"][at] = rows, np.where(rows, line.n, 0)
        arrays["seconds"][at], arrays["imbalance"][at] = columns.seconds, columns.imbalance
        stored = np.arange(rows.max(initial=1)) < rows[:, None]
        tables_of_part = {
            name: np.broadcast_to(getattr(line, name), (len(rows), line.n)) for name in LINE
        }
        for group in (columns.histories, columns.layers, columns.stress, columns.profiles):
            for name, values in group.items():
                table = values = np.asarray(values, dtype=float)
                if name not in FIELDS or columns.deep:
                    table = np.full((*stored.shape, *values.shape[1:]), np.nan)
                    table[stored] = values
                tables_of_part[name] = table
        tables.append((at, {**tables_of_part, **columns.whole}))
    axes, sizes = axes_of([table for _, of_part in tables for table in of_part.items()])
    for name, dimensions in axes.items():
        arrays[name] = np.full((count, *(sizes[axis] for axis in dimensions)), np.nan)
        for at, of_part in tables:
            if name in of_part:
                put(name, arrays[name], at, of_part[name], arrays["steps_stored"][at])
    texts = {"status": status, "error": reasons, "flags": flags}
    return arrays | {name: np.array([t.encode() for t in v]) for name, v in texts.items()}


def axes_of(
    tables: Sequence[tuple[str, Any]],
) -> tuple[dict[str, tuple[str, ...]], dict[str, int]]:
    """Return the axes but that of cases of variables by name, and the sizes of all axes.

    Such that all of some tables (cases, ...) go into them; fields may be without steps.
    """
    axes: dict[str, tuple[str, ...]] = {}
    sizes: dict[str, int] = {}
    for name, table in tables:
        dimensions = STORED[name].dimensions[len(STORED[name].dimensions) + 1 - table.ndim :]
        axes[name] = max(axes.get(name, ()), dimensions, key=len)
        for axis, size in zip(dimensions, table.shape[1:], strict=True):
            sizes[axis] = max(sizes.get(axis, 0), size)
    return axes, sizes


def put(name: str, table: Any, at: IntArray | slice, values: Any, rows: IntArray) -> None:
    """Put values of some cases into a table (cases, ...) of more cases, steps or elements.

    Parameters
    ----------
    at : places of these cases in the table.
    rows : their stored states; of fields that are stored at the last one only it takes that.
    """
    if has_layers(STORED[name]) and values.shape[-1] < table.shape[-1]:
        layers = values.shape[-1] - 1
        put(name, table[..., :layers], at, values[..., :-1], rows)
        table, values = table[..., -1:], values[..., -1:]  # the body itself is the last
    cells = tuple(map(slice, values.shape[1:]))
    if values.ndim < table.ndim:
        table[(np.arange(len(table))[at], rows - 1, *cells)] = values
    else:
        table[(at, *cells)] = values


def write_block(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write the file of a block. On one rank.

    Raises
    ------
    OSError : the disk.
    """
    with atomic_hdf5(path) as file:
        failed = int((arrays["status"] == b"failed").sum())
        file.attrs.update(software=SOFTWARE, version=__version__, failed=failed)
        for name, values in arrays.items():
            padded = values.dtype.kind == "f" and np.isnan(values).mean() > _MUCH_PADDING
            how: dict[str, Any] = PACKED if padded else {"fletcher32": True}
            file.create_dataset(name, data=values, **how)
            file[name].attrs.update(STORED[name].attributes if name in STORED else {})


def has_failed(path: Path) -> bool:
    """Tell whether a block is there, and some of its cases have failed. On one rank."""
    with suppress(InputError), reading(path, SOFTWARE, FILE_KIND) as file:
        return bool(file.attrs["failed"])
    return False


class DamagedError(Exception):
    """A block whose file is not whole."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path}: is damaged")
        self.path = path


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """Yield the file of a block to read. On one rank.

    Raises
    ------
    DamagedError : it is not whole; UnreadableError : the disk.
    """
    try:
        with reading(path, SOFTWARE, FILE_KIND) as file:
            yield file
    except UnreadableError:
        raise
    except InputError as error:
        raise DamagedError(path) from error
