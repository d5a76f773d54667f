"""The version of the package, and those of what it stands on."""

from functools import cache
from importlib.util import find_spec
from pathlib import Path

__version__ = "0.2.0"


def versions() -> dict[str, str]:
    """Return the versions that a result file records. Starts MPI and PETSc."""
    import platform

    import h5py
    import mpi4py
    import numpy
    import scipy
    from mpi4py import MPI

    from ringwear_par.petsc import PETSc

    return {
        "version": __version__,
        "python_version": platform.python_version(),
        "numpy_version": numpy.__version__,
        "scipy_version": scipy.__version__,
        "numba_version": numba_version(),
        "h5py_version": h5py.__version__,
        "mpi4py_version": mpi4py.__version__,
        "petsc_version": ".".join(map(str, PETSc.Sys.getVersion())),
        "mpi_library": MPI.Get_library_version().split(",")[0].splitlines()[0].strip("\0 "),
    }


@cache
def numba_version() -> str:
    """Return the version of Numba, which takes long to import, by the folder of its metadata."""
    spec = find_spec("numba")
    if spec is not None and spec.origin is not None:
        folders = [path.stem for path in Path(spec.origin).parents[1].glob("numba-*.dist-info")]
        if len(folders) == 1:
            return folders[0].removeprefix("numba-")
    from importlib.metadata import version  # takes long, too

    return version("numba")
