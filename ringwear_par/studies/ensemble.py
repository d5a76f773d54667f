"""The results of a sweep, to be looked at: with xarray, or variable by variable."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.errors import InputError, counted
from ringwear_par.results.hdf5 import reading
from ringwear_par.studies.end_values import END_VALUES, MAIN_END_VALUES, entries

if TYPE_CHECKING:
    import xarray

#: files of a sweep, and what the first one says of itself
RESULTS, TABLE = "results.h5", "cases.csv"
SOFTWARE, FILE_KIND = "ringwear-par sweep", "a results file of ringwear sweep"
_SEPARATOR = ", "


@dataclass(frozen=True)
class Ensemble:
    """A sweep's results without their histories, which ``histories`` reads."""

    #: of results.h5
    path: Path
    #: (cases,) str
    ids: tuple[str, ...]
    status: tuple[str, ...]
    error: tuple[str, ...]
    #: (cases,) float
    seconds: FloatArray
    #: (cases,) int
    steps_stored: IntArray
    #: values by varied key, (cases,) float, or str where they are not numbers
    varied: dict[str, Any]
    #: their units, "" for none
    units: dict[str, str]
    #: last stored values by name, (cases,) float, see ``finals``; NaN where nothing is stored
    final: dict[str, FloatArray]
    #: of the file: ``method`` of the design, ``study``, its base ``case``, ``status``, versions
    attributes: dict[str, Any]
    #: keys that the design varies by ranges: whether by logarithms, and the ends
    spacings: dict[str, tuple[bool, tuple[float, float]]]
    #: reasons to doubt the answer of a case, (cases,)
    flags: tuple[tuple[str, ...], ...]

    def histories(self, name: str, cases: IntArray) -> FloatArray:
        """Read the histories of some cases (increasing numbers), (len(cases), steps, ...)."""
        with reading(self.path, SOFTWARE, FILE_KIND) as file:
            values: FloatArray = file[name][cases]
            return values


def read_ensemble(folder: Path) -> Ensemble:
    """Read a sweep's results, by its folder or results.h5; InputError for none. Not collective."""
    path = folder if folder.name == RESULTS and folder.is_file() else folder / RESULTS
    if not path.exists():
        raise InputError(
            f"{path}: does not exist; must be written by ringwear sweep, which goes on where it "
            "was interrupted"
        )
    with reading(path, SOFTWARE, FILE_KIND) as file:
        attributes = dict(file.attrs)
        if missing := {"method", "study", "case", "status", "ranks"} - attributes.keys():
            raise ValueError(missing)
        ids, status, error, flags = (
            tuple(file[name].asstr()[:]) for name in ("case", "status", "error", "flags")
        )
        varied = [file[name] for name in attributes["coordinates"].split()]
        final: dict[str, FloatArray] = {}
        for end_value in END_VALUES.values():
            name = end_value.stored.name
            if end_value.name in MAIN_END_VALUES or name in file:
                final |= entries(end_value, file[name][:])
        stored = file["steps_stored"][:]
        if not ((stored >= 0) & (stored <= file["time"].shape[1])).all():
            raise ValueError("steps_stored")
        return Ensemble(
            path, ids, status, error, file["seconds"][:], stored,
            {key.name[1:]: key[:] if key.dtype.kind == "f" else key.asstr()[:] for key in varied},
            {key.name[1:]: {"1": ""}.get(key.attrs["units"], key.attrs["units"]) for key in varied},
            final, attributes,
            {
                key.name[1:]: (key.attrs["spacing"] == "log", (key.attrs["low"], key.attrs["high"]))
                for key in varied if "spacing" in key.attrs
            },
            tuple(map(split_flags, flags)),
        )  # fmt: skip


def open_ensemble(folder: Path | str) -> "xarray.Dataset":
    """Open the results of a sweep in xarray; arrays are read when they are used. Not collective.

    Dimensions case, step and element, each varied key a coordinate on ``case``. Close it, or use it
    in a ``with`` block, before the sweep goes on.

    Parameters
    ----------
    folder : of the sweep, or its results.h5.

    Returns
    -------
    xarray.Dataset : variables as of results, with the units in their attributes.

    Raises
    ------
    InputError : the folder holds none.
    """
    import xarray

    return xarray.open_dataset(read_ensemble(Path(folder)).path, engine="h5netcdf")


def join_flags(flags: Sequence[str]) -> str:
    """Return the flags of a case as files store them."""
    return _SEPARATOR.join(flags)


def split_flags(text: str) -> tuple[str, ...]:
    """Return the flags that a file stores of a case."""
    return tuple(text.split(_SEPARATOR)) if text else ()


def count_flags(flagged: Mapping[tuple[str, ...], int]) -> str:
    """Return a sentence on how many cases are flagged, and for which reasons."""
    counts: Counter[str] = Counter()
    for flags, n in flagged.items():
        counts.update(dict.fromkeys(flags, n))
    words = ", ".join(f"{flag.replace('_', ' ')} ({n})" for flag, n in counts.most_common())
    total = sum(flagged.values())
    return f"{counted(total, 'case')} flagged: {words}; see flags in {TABLE}"
