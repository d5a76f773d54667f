"""``ringwear info``: what this installation is made of."""

import os
import platform
import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

from ringwear_par.version import __version__

if TYPE_CHECKING:
    from mpi4py import MPI


def versions() -> dict[str, str]:
    """Return the versions that a result file records."""
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
        "numba_version": _numba_version(),
        "h5py_version": h5py.__version__,
        "mpi4py_version": mpi4py.__version__,
        "petsc_version": ".".join(map(str, PETSc.Sys.getVersion())),
        "mpi_library": MPI.Get_library_version().split(",")[0].splitlines()[0].strip("\0 "),
    }


@cache
def _numba_version() -> str:
    """Return the version of what takes long to import, and long to ask."""
    return version("numba")


def _optional(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def print_info(comm: "MPI.Comm") -> None:
    """Print versions, builds, ranks and threads. On one rank."""
    from ringwear_par.elasticity import pair_cache
    from ringwear_par.petsc import PETSc

    print(f"ringwear-par {__version__} in {os.path.dirname(__file__)}, Python {sys.executable}")
    for name, value in versions().items():
        print(f"  {name.replace('_', ' ')}: {value}")
    for package in ("matplotlib", "xarray", "h5netcdf"):
        print(f"  {package}: {_optional(package)}")
    packages = [p for p in ("scalapack", "mumps", "hdf5") if PETSc.Sys.hasExternalPackage(p)]
    print(f"  petsc packages: {', '.join(packages) or 'none of scalapack, mumps, hdf5'}")
    print(f"  petsc scalar: {PETSc.ScalarType.__name__}, integer: {PETSc.IntType.__name__}")
    launched = os.environ.get("OMPI_COMM_WORLD_SIZE") or os.environ.get("PMI_SIZE") or "no launcher"
    print(f"  ranks: {comm.size} (launcher says: {launched}), cores: {os.cpu_count()}")
    where = pair_cache.folder()
    if where is None:
        print(f"  assembled pairs: not kept ({pair_cache.VARIABLE} is empty)")
    else:
        pairs, size = pair_cache.size(where)
        print(
            f"  assembled pairs: {pairs}, {size / 1e6:.3g} of {pair_cache.LIMIT / 1e6:g} MB, "
            f"in {where}"
        )
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
        print(f"  {name}: {os.environ.get(name, 'not set')}")
