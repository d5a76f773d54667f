"""PETSc options: a prefix for each kind of solver; those with our prefixes must be used."""

import ctypes
import difflib
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ringwear_par.errors import InputError, RingwearError

if TYPE_CHECKING:
    from petsc4py import PETSc

#: of the boundary element systems and of the contact problem
BEM_PREFIX, CONTACT_PREFIX = "bem_", "contact_"


def start_petsc(words: Sequence[str]) -> None:
    """Start PETSc with options of a command line. Collective on the world's communicator.

    Without effect where it has been started. Signals stay Python's own: checkpoints on SIGTERM,
    quiet ends of pipes.

    Raises
    ------
    RingwearError : there is no PETSc for Python, or none that serves.
    """
    try:
        # MPI first: petsc4py from a wheel finds none by itself
        from mpi4py import MPI  # noqa: F401, I001
        import petsc4py

        petsc4py.init(["ringwear", "-no_signal_handler", *words])
        from petsc4py import PETSc
    except ImportError as error:
        raise RingwearError(
            f"PETSc for Python does not load ({error}): it comes with Debian's "
            "python3-petsc4py-real, with the wheel dolfinx-solver-real, or with petsc4py built for "
            "a cluster's PETSc (see README, On a cluster)"
        ) from error
    if PETSc.ScalarType is not PETSc.RealType:
        raise RingwearError("PETSc for Python is a build with complex scalars; must be real")


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


def _was_used(name: str) -> bool:
    # PetscOptionsUsed has no petsc4py call before 3.19
    from petsc4py import PETSc

    used = ctypes.c_int(0)
    ctypes.CDLL(PETSc.__file__).PetscOptionsUsed(None, name.encode(), ctypes.byref(used))
    return bool(used.value & 0xFF)


def reject_unused_options() -> None:
    """Check that every option with one of our prefixes was read by a solver. Not collective.

    Call when every kind of system was solved once: some options are read as late as that.

    Raises
    ------
    InputError : one sentence for each option.
    """
    from petsc4py import PETSc

    ours = (BEM_PREFIX, CONTACT_PREFIX)
    names = [name for name in PETSc.Options().getAll() if name.startswith(ours)]
    unused = [name for name in names if not _was_used(name)]
    if unused:
        raise InputError(
            *(
                f"-{name}: no solver of this run reads this PETSc option"
                f"{_nearest(name)}; must be one that {name.split('_')[0]}_ solvers know"
                for name in unused
            )
        )


def _nearest(name: str) -> str:
    known = [
        f"{CONTACT_PREFIX}tao_type", f"{CONTACT_PREFIX}tao_monitor", f"{CONTACT_PREFIX}tao_view",
        f"{CONTACT_PREFIX}ksp_type", f"{CONTACT_PREFIX}pc_type", f"{CONTACT_PREFIX}ksp_rtol",
        f"{BEM_PREFIX}ksp_type", f"{BEM_PREFIX}ksp_view", f"{BEM_PREFIX}pc_type",
    ]  # fmt: skip
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.8)
    return f" (did you mean -{near[0]}?)" if near else ""
