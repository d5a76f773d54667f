"""PETSc, started where nobody has started it yet."""

from ringwear_par.options import start_petsc

start_petsc([])

from petsc4py import PETSc  # noqa: E402

__all__ = ["PETSc"]

#: PETSc's own communicator of one rank, which is otherwise made anew for each solver
_SELF = PETSc.COMM_SELF.duplicate()
