"""Variables over the cases of a sweep in their file: made, and written window by window."""

import math
import zlib
from collections.abc import Callable, Mapping
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


class CaseVariable:
    """A variable over all cases, in chunks that hold whole histories as far as they are small.

    A compressed one is compressed here: HDF5 would do it as well, but much of what gzip is worth
    its time for is the same again and again, such as the radii of the contact elements.

    Parameters
    ----------
    file : with the dimensions.
    variable : which.
    kind : type of the values.
    window : cases that are written at once; a chunk has no more.
    sample : its first values, which say whether gzip is worth it; or else ``gzip``.
    """

    def __init__(
        self,
        file: h5py.File,
        variable: Variable,
        kind: Any,
        window: int = WINDOW,
        *,
        sample: Any = None,
        gzip: bool = False,
    ) -> None:
        shape = tuple(len(file[name]) for name in variable.dimensions)
        size, chunks = np.dtype(kind).itemsize, list(shape)
        for axis in range(len(shape)):
            rest = size * math.prod(chunks[axis + 1 :])
            chunks[axis] = min(shape[axis], max(1, int(_CHUNK_BYTES // rest)))
        rows = power_of_2(_CHUNK_BYTES / (size * math.prod(chunks[1:])))
        chunks[0] = min(shape[0], rows, window)
        if sample is not None:
            first = np.ascontiguousarray(sample[tuple(map(slice, chunks))]).tobytes()
            gzip = len(zlib.compress(first, 1)) * _WORTH_IT < len(first)
        extra: dict[str, Any] = {"compression": "gzip", "compression_opts": 1} if gzip else {}
        if np.dtype(kind).kind == "f":
            extra["fillvalue"] = np.nan
        self._dataset = file.create_dataset(
            variable.name, shape, dtype=kind, chunks=tuple(chunks), **extra
        )
        self._dataset.attrs.update(variable.attributes)
        if np.dtype(kind).kind == "S":
            self._dataset.attrs.update(_ENCODED)
        for axis, name in enumerate(variable.dimensions):
            self._dataset.dims[axis].attach_scale(file[name])
        self._direct = gzip and tuple(chunks[1:]) == shape[1:]
        #: the last chunk, and its compressed bytes
        self._chunk = (b"", b"")

    def write(self, start: int, values: Any) -> None:
        """Write the values of cases from one on: whole chunks, but for the last."""
        dataset = self._dataset
        if not self._direct:
            dataset[start : start + len(values)] = values
            return
        rows, rest = dataset.chunks[0], (0,) * (dataset.ndim - 1)
        for first in range(0, len(values), rows):
            data = np.ascontiguousarray(values[first : first + rows], dtype=dataset.dtype).tobytes()
            data += bytes(math.prod(dataset.chunks) * dataset.dtype.itemsize - len(data))
            if data != self._chunk[0]:
                self._chunk = data, zlib.compress(data, 1)
            dataset.id.write_direct_chunk((start + first, *rest), self._chunk[1])


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
    column, count = CaseVariable(file, variable, kind, window, gzip=True), len(file["case"])
    for start in range(0, count, window):
        column.write(start, texts(slice(start, min(start + window, count))))
