"""The results of a sweep, to be looked at: with xarray, or variable by variable."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.errors import InputError
from ringwear_par.studies.dataset import FINAL, RESULTS, SOFTWARE

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True)
class Ensemble:
    """A sweep's results without their histories, which ``histories`` reads.

    Parameters
    ----------
    path : of results.h5.
    ids, status, error : (cases,) str.
    in_study : (cases,) bool.
    seconds : (cases,) float.
    steps_stored : (cases,) int.
    varied : values by varied key, (cases,) float, or str where they are not numbers.
    final : last stored values of FINAL, (cases,) float, NaN where nothing is stored.
    attributes : of the file: ``method`` of the design, ``study``, ``status``, versions.
    """

    path: Path
    ids: tuple[str, ...]
    status: tuple[str, ...]
    error: tuple[str, ...]
    in_study: BoolArray
    seconds: FloatArray
    steps_stored: IntArray
    varied: dict[str, Any]
    final: dict[str, FloatArray]
    attributes: dict[str, Any]

    def histories(self, name: str, cases: IntArray) -> FloatArray:
        """Read the histories of some cases (increasing numbers), (len(cases), steps)."""
        with h5py.File(self.path, "r") as file:
            return file[name][cases]


def read_ensemble(folder: Path) -> Ensemble:
    """Read a sweep's results. Not collective.

    Raises
    ------
    InputError : the folder holds none.
    """
    path = folder / RESULTS
    if not path.exists():
        raise InputError(
            f"{path}: does not exist; must be written by ringwear sweep (without --slice), which "
            "goes on where it was interrupted"
        )
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("software") != SOFTWARE:
                raise KeyError("software")
            names = str(file.attrs["coordinates"]).split()
            texts = {n: tuple(file[n].asstr()[:]) for n in ("case", "status", "error", "in_study")}
            varied = {}
            for name in names:
                plain = file[name].dtype.kind == "f"
                varied[name] = file[name][:] if plain else file[name].asstr()[:]
            return Ensemble(
                path, texts["case"], texts["status"], texts["error"],
                np.array([word == "yes" for word in texts["in_study"]]),
                file["seconds"][:], file["steps_stored"][:], varied,
                {name: file[f"final_{name}"][:] for name in FINAL},
                dict(file.attrs),
            )  # fmt: skip
    except (OSError, KeyError, RuntimeError) as error:
        raise InputError(
            f"{path}: is not a results file of ringwear sweep, or is damaged"
        ) from error


def open_ensemble(folder: Path | str) -> "xarray.Dataset":
    """Open the results of a sweep in xarray; arrays are read when they are used. Not collective.

    Dimensions case, step and element, each varied key a coordinate on ``case``. Close it, or use it
    in a ``with`` block, before the sweep goes on.

    Raises
    ------
    InputError : the folder holds none, or xarray and h5netcdf are not installed.
    """
    path = read_ensemble(Path(folder)).path
    try:
        import xarray
    except ImportError as error:
        raise InputError(
            f"{path}: needs xarray and h5netcdf to be opened so; pip install "
            '"ringwear-par[xarray]" installs them'
        ) from error
    return xarray.open_dataset(path, engine="h5netcdf")
