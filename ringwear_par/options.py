"""PETSc options with our prefixes that nobody used are errors."""

import ctypes
import difflib

from petsc4py import PETSc

from ringwear_par.contact import solver as contact
from ringwear_par.elasticity import solve as dense
from ringwear_par.errors import InputError

PREFIXES = (dense.PREFIX, contact.PREFIX)


def _was_used(name: str) -> bool:
    # PetscOptionsUsed has no petsc4py call before 3.19
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
    names = [name for name in PETSc.Options().getAll() if name.startswith(PREFIXES)]
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
        f"{contact.PREFIX}tao_type", f"{contact.PREFIX}tao_monitor", f"{contact.PREFIX}tao_view",
        f"{contact.PREFIX}ksp_type", f"{contact.PREFIX}pc_type", f"{contact.PREFIX}ksp_rtol",
        f"{dense.PREFIX}ksp_type", f"{dense.PREFIX}ksp_view", f"{dense.PREFIX}pc_type",
    ]  # fmt: skip
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.8)
    return f" (did you mean -{near[0]}?)" if near else ""
