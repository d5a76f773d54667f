"""``ringwear info``: the versions of an installation, and the keys of files."""

import difflib
import logging
import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ringwear_par.errors import InputError, legible
from ringwear_par.version import __version__, versions

if TYPE_CHECKING:
    from mpi4py import MPI

log = logging.getLogger(__name__)


def _optional(package: str) -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


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
    folder = pair_cache.folder()
    if folder is None:
        print(f"  assembled contact pairs: not kept ({pair_cache.VARIABLE} is empty)")
    else:
        pairs, size = pair_cache.size(folder)
        print(
            f"  assembled contact pairs: {pairs}, {size / 1e6:.3g} of "
            f"{pair_cache.LIMIT / 1e6:g} MB, in {folder}"
        )
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
        print(f"  {name}: {os.environ.get(name, 'not set')}")


def _print_keys(words: Sequence[str]) -> None:
    """Print the keys of case, study, fit and measure files, or of one of these; a row a key."""
    from ringwear_par.cases import schema as cases
    from ringwear_par.cases.tables import key_table
    from ringwear_par.identification.definition import schema as fits
    from ringwear_par.measuring.definition import schema as measures
    from ringwear_par.studies.definition import schema as studies

    schemas = {
        "case": cases.KEYS, "study": studies.KEYS, "measure": measures.KEYS, "fit": fits.KEYS,
    }  # fmt: skip
    kinds = words[:1] if words and words[0] in schemas else list(schemas)
    phrase = " ".join(words[1:] if words[:1] == kinds else words)
    tables = {kind: key_table(schemas[kind], phrase) for kind in kinds}
    near = difflib.get_close_matches(phrase, schemas, n=1) if len(kinds) > 1 else []
    hint = f" (did you mean {near[0]}?)" if near else ""
    if not any(tables.values()):
        files = " or ".join(kinds)
        raise InputError(
            f"--schema {legible(phrase)}: is in no row of the keys of {files} files{hint}"
        )
    if near:
        log.warning("--schema %s: is no kind of file%s; rows with this word", phrase, hint)
    for kind, table in tables.items():
        if len(kinds) > 1:
            print(f"Keys of {kind} files\n")
        print(table or f"  none with {phrase}", end="\n\n" if kind != kinds[-1] else "\n")
