"""The version of the package, and those of what it stands on."""

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
        "h5py_version": h5py.__version__,
        "mpi4py_version": mpi4py.__version__,
        "petsc_version": ".".join(map(str, PETSc.Sys.getVersion())),
        "mpi_library": MPI.Get_library_version().split(",")[0].splitlines()[0].strip("\0 "),
    }
