"""Variables over the cases of a sweep in their file: made, and written window by window."""

import math
import zlib
from collections.abc import Mapping
from typing import Any

import h5py
import numpy as np

from ringwear_par.results.variables import ELEMENT, Variable
from ringwear_par.studies.storage.results_file import SAME_STEPS, cases_at_once, power_of_2
from ringwear_par.studies.storage.stored_variables import AXES

#: of a chunk in the file
_CHUNK_BYTES = 256e3
#: most cases that are made texts of, or are rows of a table, at once
WINDOW = 2**13
#: a variable whose first chunk gzip makes so much smaller is stored so; it takes no time then
_WORTH_IT = 8
#: with which xarray takes bytes for the texts that they are
_ENCODED = {"_Encoding": "utf-8"}


def text_dtype(size: int) -> Any:
    """Return the type of texts of at most so many bytes, which gzip shrinks as no others."""
    return h5py.string_dtype("utf-8", max(size, 1))


def text_window(kind: Any) -> int:
    """Return how many cases to write the texts of at once."""
    return min(WINDOW, cases_at_once(kind.itemsize))


def make_scales(
    file: h5py.File, ids: Any, steps: int, elements: int, axes: Mapping[str, int]
) -> None:
    """Make the dimensions; ``step`` is numbered, until it is known to be the same in all cases.

    Parameters
    ----------
    axes : sizes of those beside cases, steps and elements.
    """
    kind = text_dtype(ids.dtype.itemsize)
    file.create_dataset("case", data=ids.astype(kind), dtype=kind)
    meaning = "case, by its content"
    file["case"].attrs.update({"units": "1", "long_name": meaning, **_ENCODED})
    file.create_dataset("step", data=np.arange(steps))
    meaning = "stored step (their numbers differ from case to case)"
    file["step"].attrs.update({"units": "1", "long_name": meaning, SAME_STEPS: 0})
    file.create_dataset("element", data=np.arange(elements))
    file["element"].attrs.update(ELEMENT.attributes)
    for name, size in axes.items():
        file.create_dataset(name, data=np.arange(size))
        file[name].attrs.update(AXES[name].attributes)
    for name in ("case", "step", "element", *axes):
        file[name].make_scale(name)


class ColumnWriter:
    """Writes a variable window by window; what is compressed by itself.

    HDF5 would do it as well; but much of what gzip is worth its time for is the same again and
    again, such as the radii of the contact elements, and then need not be compressed again.

    Parameters
    ----------
    dataset : whose windows are whole chunks, but for the last.
    """

    def __init__(self, dataset: h5py.Dataset) -> None:
        self._dataset, self._known = dataset, (b"", b"")
        self._direct = dataset.compression == "gzip" and dataset.chunks[1:] == dataset.shape[1:]

    def write(self, start: int, values: Any) -> None:
        """Write the values of cases from one on."""
        dataset = self._dataset
        if not self._direct:
            dataset[start : start + len(values)] = values
            return
        rows, rest = dataset.chunks[0], (0,) * (dataset.ndim - 1)
        for first in range(0, len(values), rows):
            data = np.ascontiguousarray(values[first : first + rows], dtype=dataset.dtype).tobytes()
            data += bytes(math.prod(dataset.chunks) * dataset.dtype.itemsize - len(data))
            if data != self._known[0]:
                self._known = data, zlib.compress(data, 1)
            dataset.id.write_direct_chunk((start + first, *rest), self._known[1])


def make_variable(
    file: h5py.File,
    variable: Variable,
    kind: Any,
    window: int,
    *,
    sample: Any = None,
    gzip: bool = False,
) -> h5py.Dataset:
    """Make a variable, in chunks that hold whole histories as far as they are small.

    Parameters
    ----------
    window : cases that are written at once; a chunk has no more.
    sample : its first values, which tell whether gzip is worth it; or else ``gzip``.
    """
    shape = tuple(len(file[name]) for name in variable.dimensions)
    size = np.dtype(kind).itemsize
    chunks = list(shape)
    for axis in range(len(shape)):
        rest = size * math.prod(chunks[axis + 1 :])
        chunks[axis] = min(shape[axis], max(1, int(_CHUNK_BYTES // rest)))
    chunks[0] = min(shape[0], power_of_2(_CHUNK_BYTES / (size * math.prod(chunks[1:]))), window)
    extra: dict[str, Any] = {}
    if np.dtype(kind).kind == "f":
        extra["fillvalue"] = np.nan
    if sample is not None:
        first = np.ascontiguousarray(sample[tuple(map(slice, chunks))]).tobytes()
        gzip = len(zlib.compress(first, 1)) * _WORTH_IT < len(first)
    if gzip:
        extra |= {"compression": "gzip", "compression_opts": 1}
    dataset = file.create_dataset(variable.name, shape, dtype=kind, chunks=tuple(chunks), **extra)
    dataset.attrs.update(variable.attributes)
    if np.dtype(kind).kind == "S":
        dataset.attrs.update(_ENCODED)
    for axis, name in enumerate(variable.dimensions):
        dataset.dims[axis].attach_scale(file[name])
    return dataset
