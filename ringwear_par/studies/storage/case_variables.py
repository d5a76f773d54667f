"""Variables over the cases of a sweep in their file: made, and written window by window."""

import math
import zlib
from collections.abc import Callable, Mapping
from typing import Any

import h5py
import numpy as np

from ringwear_par.results.variables import ELEMENT, LINE, Variable
from ringwear_par.studies.storage.results_file import cases_at_once, power_of_2
from ringwear_par.studies.storage.stored_variables import AXES

#: of a chunk in the file
_CHUNK_BYTES = 256e3
#: most cases that are made texts of, or are rows of a table, at once
WINDOW = 2**13
#: with which xarray takes bytes for the texts that they are
_ENCODED = {"_Encoding": "utf-8"}


def text_dtype(size: int) -> Any:
    """Return the type of texts of at most so many bytes, which gzip shrinks as no others."""
    return h5py.string_dtype("utf-8", max(size, 1))


def make_scales(
    file: h5py.File, ids: Any, steps: int, elements: int, axes: Mapping[str, int]
) -> None:
    """Make the dimensions.

    Parameters
    ----------
    axes : sizes of those beside cases, steps and elements.
    """
    kind = text_dtype(ids.dtype.itemsize)
    file.create_dataset("case", data=ids.astype(kind), dtype=kind)
    meaning = "case, by its content"
    file["case"].attrs.update({"units": "1", "long_name": meaning, **_ENCODED})
    file.create_dataset("step", data=np.arange(steps))
    file["step"].attrs.update({"units": "1", "long_name": "stored state of each case"})
    file.create_dataset("element", data=np.arange(elements))
    file["element"].attrs.update(ELEMENT.attributes)
    for name, size in axes.items():
        file.create_dataset(name, data=np.arange(size))
        file[name].attrs.update(AXES[name].attributes)
    for name in ("case", "step", "element", *axes):
        file[name].make_scale(name)


class CaseVariable:
    """A variable over all cases, in chunks that hold whole histories as far as they are small.

    Chunks are compressed here, such that HDF5 knows how to read them: twice as fast as HDF5 would
    do it, as runs of the same byte are looked for only. Most of what can be saved is in these, once
    the bytes of all numbers are sorted by their weight: padding, exponents, what does not change.

    Parameters
    ----------
    file : with the dimensions.
    variable : which.
    kind : type of the values.
    window : cases that are written at once; a chunk has no more.
    """

    def __init__(
        self,
        file: h5py.File,
        variable: Variable,
        kind: Any,
        window: int = WINDOW,
    ) -> None:
        shape = tuple(len(file[name]) for name in variable.dimensions)
        size, chunks = np.dtype(kind).itemsize, list(shape)
        for axis in range(len(shape)):
            rest = size * math.prod(chunks[axis + 1 :])
            chunks[axis] = min(shape[axis], max(1, int(_CHUNK_BYTES // rest)))
        rows = power_of_2(_CHUNK_BYTES / (size * math.prod(chunks[1:])))
        chunks[0] = min(shape[0], rows, window)
        letter = np.dtype(kind).kind
        fill = {"fillvalue": np.nan} if letter == "f" else {}
        self._dataset = file.create_dataset(
            variable.name, shape, dtype=kind, chunks=tuple(chunks), compression="gzip",
            compression_opts=1, shuffle=letter != "S", **fill,
        )  # fmt: skip
        self._dataset.attrs.update(variable.attributes)
        if letter == "S":
            self._dataset.attrs.update(_ENCODED)
        for axis, name in enumerate(variable.dimensions):
            self._dataset.dims[axis].attach_scale(file[name])
        self._whole = tuple(chunks[1:]) == shape[1:]
        #: texts, and elements of the contact line, repeat from case to case, which is no run
        runs = letter != "S" and variable.name not in LINE
        self._strategy = zlib.Z_RLE if runs else zlib.Z_DEFAULT_STRATEGY
        #: the last chunk, and its compressed bytes
        self._chunk = (b"", b"")

    def write(self, start: int, values: Any) -> None:
        """Write the values of cases from one on: whole chunks, but for the last."""
        dataset = self._dataset
        if not self._whole:
            dataset[start : start + len(values)] = values
            return
        rows, rest = dataset.chunks[0], (0,) * (dataset.ndim - 1)
        for first in range(0, len(values), rows):
            data = np.ascontiguousarray(values[first : first + rows], dtype=dataset.dtype).tobytes()
            data += bytes(math.prod(dataset.chunks) * dataset.dtype.itemsize - len(data))
            if data != self._chunk[0]:
                self._chunk = data, self._compressed(data)
            dataset.id.write_direct_chunk((start + first, *rest), self._chunk[1])

    def _compressed(self, data: bytes) -> bytes:
        """Return a chunk as HDF5's filters "shuffle" and "deflate" would make it."""
        if self._dataset.shuffle:
            table = np.frombuffer(data, np.uint8).reshape(-1, self._dataset.dtype.itemsize)
            data = table.T.tobytes()
        gzip = zlib.compressobj(
            1, zlib.DEFLATED, zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, self._strategy
        )
        return gzip.compress(data) + gzip.flush()


def write_texts(
    file: h5py.File, variable: Variable, longest: int, texts: Callable[[slice], Any]
) -> None:
    """Write texts of cases, window by window.

    Parameters
    ----------
    longest : bytes of the longest.
    texts : returns those of a stretch of the cases, as bytes.
    """
    kind = text_dtype(longest)
    window = min(WINDOW, cases_at_once(kind.itemsize))
    column, count = CaseVariable(file, variable, kind, window), len(file["case"])
    for start in range(0, count, window):
        column.write(start, texts(slice(start, min(start + window, count))))
