"""The arrays of a block: padded to (cases, ...), and its file, which is there whole or not."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.arrays import IntArray
from ringwear_par.errors import InputError, reason_of
from ringwear_par.results.hdf5 import UnreadableError, atomic_hdf5, reading
from ringwear_par.results.result import HistoryColumns
from ringwear_par.results.variables import LINE
from ringwear_par.studies.end_values import FIELDS, STORED, has_layers
from ringwear_par.studies.ensemble import SOFTWARE, join_flags
from ringwear_par.version import __version__

FILE_KIND = "a block of a sweep"
#: how variables are compressed
PACKED = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
#: share of padding above which they are compressed in a block, too, which is gone once it is merged
_MUCH_PADDING = 0.25
#: of each case, beside its history
_NUMBERS = {"steps_stored": int, "elements": int, "seconds": float, "imbalance": float}


def arrays_of(
    cases: Sequence[Any],
    parts: Sequence[tuple[IntArray, HistoryColumns]],
    errors: Mapping[int, Exception],
) -> dict[str, Any]:
    """Return what is stored of a block's cases, by name, (cases, ...), but their ids.

    Parameters
    ----------
    parts : places of cases in the block, and their histories.
    errors : why the others have none, by place.
    """
    count = len(cases)
    texts = {
        "status": ["failed"] * count,
        "error": [reason_of(errors[i]) if i in errors else "" for i in range(count)],
        "flags": [""] * count,
    }
    arrays: dict[str, Any] = {name: np.zeros(count, dtype) for name, dtype in _NUMBERS.items()}
    tables: list[dict[str, Any]] = []
    for at, columns in parts:
        rows, line = np.diff(columns.offsets), cases[at[0]].line
        for i, place in enumerate(at.tolist()):
            texts["status"][place] = columns.status[i]
            texts["error"][place] = columns.reason[i]
            texts["flags"][place] = join_flags(columns.flags[i])
        arrays["steps_stored"][at], arrays["elements"][at] = rows, np.where(rows, line.n, 0)
        arrays["seconds"][at], arrays["imbalance"][at] = columns.seconds, columns.imbalance
        stored = np.arange(rows.max(initial=1)) < rows[:, None]
        tables.append(
            {n: np.tile(getattr(line, n), (len(rows), 1)) for n in LINE} | {**columns.whole}
        )
        for group in (columns.histories, columns.layers, columns.stress, columns.profiles):
            for name, values in group.items():
                table = values = np.asarray(values, dtype=float)
                if name not in FIELDS or columns.deep:
                    table = np.full((*stored.shape, *values.shape[1:]), np.nan)
                    table[stored] = values
                tables[-1][name] = table
    axes, sizes = axes_of([(n, table.shape) for of_part in tables for n, table in of_part.items()])
    for name, dimensions in axes.items():
        shape = tuple(sizes[axis] for axis in dimensions)
        arrays[name] = np.full((count, *shape), np.nan)
        for (at, _), of_part in zip(parts, tables, strict=True):
            if name in of_part:
                rows = arrays["steps_stored"][at]
                arrays[name][at] = padded(name, of_part[name], shape, rows)
    return arrays | {name: np.array([t.encode() for t in v]) for name, v in texts.items()}


def axes_of(
    shapes: Iterable[tuple[str, tuple[int, ...]]],
) -> tuple[dict[str, tuple[str, ...]], dict[str, int]]:
    """Return the axes but that of cases of variables by name, and the sizes of all axes.

    Such that tables (cases, ...) of these shapes go into them; fields may be without steps.
    """
    axes: dict[str, tuple[str, ...]] = {}
    sizes: dict[str, int] = {}
    for name, shape in shapes:
        dimensions = STORED[name].dimensions[len(STORED[name].dimensions) + 1 - len(shape) :]
        axes[name] = max(axes.get(name, ()), dimensions, key=len)
        for axis, size in zip(dimensions, shape[1:], strict=True):
            sizes[axis] = max(sizes.get(axis, 0), size)
    return axes, sizes


def padded(name: str, values: Any, shape: tuple[int, ...], rows: IntArray) -> Any:
    """Return the values of cases, (cases, *shape), NaN where they have fewer states or elements.

    Parameters
    ----------
    rows : (cases,) stored states; fields that are stored at the last one only go there.
    """
    if values.shape[1:] == shape:
        return values
    table = np.full((len(values), *shape), np.nan)
    cells = tuple(map(slice, values.shape[1:]))
    if values.ndim < table.ndim:
        table[(np.arange(len(table)), rows - 1, *cells)] = values
    elif has_layers(STORED[name]):  # the body itself is the last
        table[(slice(None), *cells)][..., :-1] = values[..., :-1]
        table[(slice(None), *cells[:-1], -1)] = values[..., -1]
    else:
        table[(slice(None), *cells)] = values
    return table


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
