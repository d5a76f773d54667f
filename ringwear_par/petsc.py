"""PETSc, started for whoever has not started it: without its signal handler.

Signals stay Python's own, so that a script ends on a closed pipe or Ctrl-C as any other. Options
are those of ``petsc4py.init`` where a program calls it first, as the command line does.
"""

import petsc4py

petsc4py.init(["ringwear", "-no_signal_handler"])  # no effect where PETSc has been started

from petsc4py import PETSc  # noqa: E402

__all__ = ["PETSc"]
