"""Start of PETSc with options of the command line; the prefix of each kind of solver."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ringwear_par.errors import InputError, RingwearError, legible

if TYPE_CHECKING:
    from petsc4py import PETSc

#: of the boundary element systems, and of the contact problem
BEM_PREFIX, CONTACT_PREFIX = "bem_", "contact_"


def start_petsc(words: Sequence[str]) -> None:
    """Start PETSc with options of a command line. Collective on the world's communicator.

    Without effect where it has been started.
    Signals stay Python's own: checkpoints on SIGTERM, quiet ends of pipes.

    Raises
    ------
    InputError : PETSc does not accept them.
    RingwearError : there is no PETSc for Python, or none that serves.
    """
    try:
        # MPI first: petsc4py from a wheel finds none by itself
        from mpi4py import MPI  # noqa: F401, I001
        import petsc4py

        reports = ["-options_left"] if words else []  # of those that nobody has read, at the end
        petsc4py.init(["ringwear", *words, *reports, "-no_signal_handler"])
        from petsc4py import PETSc
    except ImportError as error:
        raise RingwearError(
            f"PETSc for Python does not load ({error}): it comes with Debian's "
            "python3-petsc4py-real, with conda-forge's petsc4py (environment.yml), or built for a "
            "cluster's PETSc (see docs/howto/cluster.md)"
        ) from error
    except RuntimeError as error:  # what PETSc's own are
        raise InputError(f"-- {legible(' '.join(words))}: PETSc does not accept it") from error
    if PETSc.ScalarType is not PETSc.RealType:
        raise RingwearError("PETSc for Python is a build with complex scalars; must be real")


def contact_solver() -> str:
    """Return what solves the contacts of one history: "tao", or "block" by ``-contact_solver``.

    Raises
    ------
    InputError : it is neither.
    """
    from petsc4py import PETSc

    solver = PETSc.Options(CONTACT_PREFIX).getString("solver", "tao")
    if solver not in ("tao", "block"):
        raise InputError(f'-contact_solver {legible(solver)}: must be "tao" or "block"')
    return solver


def set_from_options(solver: "PETSc.KSP | PETSc.TAO", prefix: str) -> None:
    """Let a solver read its PETSc options. Collective on the solver.

    Raises
    ------
    InputError : PETSc does not accept a value.
    """
    from petsc4py import PETSc

    try:
        solver.setFromOptions()
    except PETSc.Error as error:
        raise InputError(
            f"-{prefix}... options: PETSc does not accept one of them (error {error.ierr}); types "
            "must be among those of this PETSc"
        ) from error
