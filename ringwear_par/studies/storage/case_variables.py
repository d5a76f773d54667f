"""Variables over the cases of a sweep in their file: made, and written window by window."""

import itertools
import math
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np

from ringwear_par.results.variables import ELEMENT, LINE, Variable
from ringwear_par.studies.storage.results_file import power_of_2
from ringwear_par.studies.storage.stored_variables import AXES

#: bytes of a chunk in the file
_CHUNK_BYTES = 256e3
#: most cases of which texts, or rows of a table, are made together
WINDOW = 2**11
#: share of bytes equal to the one before above which bytes of one weight are compressed: a search
#: for runs takes more time than all the rest of writing, and saves 5 % of the file
_REPEATED = 0.15
#: of zlib's streams
_HEADER = b"\x78\x01"
#: with which xarray takes bytes for the texts that they are
_ENCODED = {"_Encoding": "utf-8"}


def stretches(count: int, size: int) -> Iterator[slice]:
    """Yield stretches of so many cases, the last one of fewer."""
    return (slice(start, min(start + size, count)) for start in range(0, count, size))


def text_dtype(size: int) -> Any:
    """Return the type of texts of at most so many bytes, which gzip shrinks as no others."""
    return h5py.string_dtype("utf-8", max(size, 1))


def make_scales(
    file: h5py.File, ids: Any, steps: int, elements: int, axes: Mapping[str, int]
) -> None:
    """Make the dimensions: cases, steps, elements, and the axes with their sizes."""
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


@dataclass(frozen=True)
class Chunks:
    """How a variable over all cases is cut and compressed in their file.

    A chunk holds whole histories, as far as they are small. They are compressed here, such that
    HDF5 knows how to read them, by any rank and much faster than HDF5 would do it: only runs of the
    same byte are looked for, and only where there are some once the bytes of all numbers are sorted
    by their weight: padding, exponents, what does not change.
    """

    #: of the variable
    name: str
    #: of all its values, cases first
    shape: tuple[int, ...]
    #: type of the values
    kind: Any
    #: of a chunk
    sizes: tuple[int, ...]

    @classmethod
    def of(cls, name: str, shape: tuple[int, ...], kind: Any, window: int) -> "Chunks":
        """Return the chunks of a variable, none of more cases than are written at once."""
        size, chunks = np.dtype(kind).itemsize, list(shape)
        for axis in range(len(shape)):
            rest = size * math.prod(chunks[axis + 1 :])
            chunks[axis] = min(shape[axis], max(1, int(_CHUNK_BYTES // rest)))
        rows = power_of_2(_CHUNK_BYTES / (size * math.prod(chunks[1:])))
        chunks[0] = min(shape[0], rows, window)
        return cls(name, shape, kind, tuple(chunks))

    @property
    def is_text(self) -> bool:
        """Whether the values are texts, whose bytes are not sorted."""
        return np.dtype(self.kind).kind == "S"

    def packed(self, values: Any) -> Any:
        """Return the values of some cases as ``write`` takes them: the bytes of each chunk."""
        if self.sizes[1:] != self.shape[1:]:  # of huge histories: HDF5 has to cut them
            return values
        packed: list[bytes] = []
        before, rows = b"", self.sizes[0]
        for first in range(0, len(values), rows):
            data = np.ascontiguousarray(values[first : first + rows], dtype=self.kind).tobytes()
            data += bytes(math.prod(self.sizes) * np.dtype(self.kind).itemsize - len(data))
            packed.append(packed[-1] if data == before else self._compressed(data))
            before = data
        return packed

    def _compressed(self, data: bytes) -> bytes:
        """Return a chunk as HDF5's filters "shuffle" and "deflate" would make it."""
        if self.is_text:
            return zlib.compress(data, 1)
        size = np.dtype(self.kind).itemsize
        together = math.gcd(len(data) // size, 64)  # NumPy sorts so many numbers in less time
        blocks = np.frombuffer(data, np.uint8).reshape(-1, together, size)
        planes = np.ascontiguousarray(blocks.transpose(2, 0, 1)).reshape(size, -1)
        # the line repeats from case to case: that is no run, nor is one number
        if self.name in LINE or planes.shape[1] < 2:
            return zlib.compress(planes.data, 1)
        least = _REPEATED * planes.shape[1]
        repeated = [np.count_nonzero(plane[1:] == plane[:-1]) > least for plane in planes]
        stream, first = [_HEADER], 0
        for in_runs, alike in itertools.groupby(repeated):
            last = first + len(list(alike))
            ending = zlib.Z_FINISH if last == len(planes) else zlib.Z_FULL_FLUSH
            part = zlib.compressobj(
                int(in_runs), zlib.DEFLATED, -zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, zlib.Z_RLE
            )
            stream += part.compress(planes[first:last].data), part.flush(ending)
            first = last
        return b"".join((*stream, zlib.adler32(planes.data).to_bytes(4, "big")))


class CaseVariable:
    """A variable over all cases in their file, written window by window."""

    def __init__(self, file: h5py.File, variable: Variable, kind: Any, window: int) -> None:
        self._window = window
        shape = tuple(len(file[name]) for name in variable.dimensions)
        self.chunks = chunks = Chunks.of(variable.name, shape, kind, window)
        fill = {"fillvalue": np.nan} if np.dtype(kind).kind == "f" else {}
        self._dataset = file.create_dataset(
            variable.name, shape, dtype=kind, chunks=chunks.sizes, compression="gzip",
            compression_opts=1, shuffle=not chunks.is_text, **fill,
        )  # fmt: skip
        self._dataset.attrs.update({**variable.attributes, **(_ENCODED if chunks.is_text else {})})
        for axis, name in enumerate(variable.dimensions):
            self._dataset.dims[axis].attach_scale(file[name])

    def write(self, start: int, packed: Any) -> None:
        """Write the values of cases from one on, see ``Chunks.packed``."""
        if not isinstance(packed, list):
            self._dataset[start : start + len(packed)] = packed
            return
        rows, rest = self.chunks.sizes[0], (0,) * (self._dataset.ndim - 1)
        for number, chunk in enumerate(packed):
            self._dataset.id.write_direct_chunk((start + number * rows, *rest), chunk)

    def write_all(self, values: Callable[[slice], Any]) -> None:
        """Write the values of all cases, which are returned for stretches of them."""
        count = self.chunks.shape[0]
        for start in range(0, count, self._window):
            part = values(slice(start, min(start + self._window, count)))
            self.write(start, self.chunks.packed(part))
