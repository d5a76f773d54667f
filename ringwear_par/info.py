"""``ringwear info``: the versions of an installation, and the keys of files."""

import os
import sys
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

from ringwear_par.errors import InputError, legible
from ringwear_par.version import __version__, versions

if TYPE_CHECKING:
    from mpi4py import MPI


def print_info(comm: "MPI.Comm", schema: Sequence[str] | None = None) -> None:
    """Print versions, builds, ranks and threads; or the keys of files. Not collective.

    Parameters
    ----------
    schema : a kind of file or none, and then words of the rows of keys; None: no keys.

    Raises
    ------
    InputError : no key has the words.
    """
    if schema is None:
        _print_installation(comm)
    else:
        _print_keys(schema)


def _print_installation(comm: "MPI.Comm") -> None:
    from ringwear_par.petsc import PETSc

    print(f"ringwear-par {__version__} in {os.path.dirname(__file__)}, Python {sys.executable}")
    rows = {name.replace("_", " "): value for name, value in versions().items()}
    for package in ("matplotlib", "xarray", "h5netcdf"):
        try:
            rows[package] = version(package)
        except PackageNotFoundError:
            rows[package] = "not installed"
    packages = [p for p in ("scalapack", "mumps", "hdf5") if PETSc.Sys.hasExternalPackage(p)]
    rows["petsc packages"] = ", ".join(packages) or "none of scalapack, mumps, hdf5"
    rows["petsc scalar"] = f"{PETSc.ScalarType.__name__}, integer: {PETSc.IntType.__name__}"
    launched = os.environ.get("OMPI_COMM_WORLD_SIZE") or os.environ.get("PMI_SIZE") or "no launcher"
    rows["ranks"] = f"{comm.size} (launcher says: {launched}), cores: {os.cpu_count()}"
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        rows[name] = os.environ.get(name, "not set")
    for name, value in rows.items():
        print(f"  {name}: {value}")


def _print_keys(words: Sequence[str]) -> None:
    """Print the keys of case, study, fit and measure files, or of one of these; a row a key."""
    from ringwear_par.cases import schema as cases
    from ringwear_par.cases.tables import key_table
    from ringwear_par.identification.definition import schema as fits
    from ringwear_par.measuring.definition import schema as measures
    from ringwear_par.studies import variations as studies

    schemas = {
        "case": cases.KEYS, "study": studies.KEYS, "measure": measures.KEYS, "fit": fits.KEYS,
    }  # fmt: skip
    kinds = words[:1] if words and words[0] in schemas else list(schemas)
    phrase = " ".join(words[1:] if words[:1] == kinds else words)
    tables = {kind: key_table(schemas[kind], phrase) for kind in kinds}
    if not any(tables.values()):
        raise InputError(
            f"--schema {legible(phrase)}: is in no row of the keys of {' or '.join(kinds)} files"
        )
    if len(kinds) == 1:
        print(tables[kinds[0]])
        return
    for kind, table in tables.items():
        if table:
            print(f"Keys of {kind} files\n\n{table}\n")
