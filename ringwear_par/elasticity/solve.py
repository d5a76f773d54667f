"""Distributed dense systems in PETSc: factorise once, solve for many right-hand sides.

One rank uses the LU of the sequential dense matrix. Several ranks convert it to ScaLAPACK's
block-cyclic layout where PETSc has that, and otherwise (or with ``-bem_pc_type redundant``) let
every rank factorise a copy of the whole.
"""

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.assembly import Rows
from ringwear_par.errors import ComputationError
from ringwear_par.options import BEM_PREFIX, set_from_options
from ringwear_par.petsc import PETSc

#: largest residual of a row, relative to the sum of its terms
RESIDUAL_TOLERANCE = 1e-9


def has_scalapack() -> bool:
    """Tell whether this PETSc can factorise a distributed dense matrix. Not collective."""
    return bool(PETSc.Sys.hasExternalPackage("scalapack"))


def _matrix(local: FloatArray, columns: tuple[int, int], comm: MPI.Comm) -> PETSc.Mat:
    matrix = PETSc.Mat().createDense(
        size=((local.shape[0], PETSc.DETERMINE), columns), array=local, comm=comm
    )
    matrix.assemble()
    return matrix


def solve_rows(rows: Rows, comm: MPI.Comm) -> tuple[FloatArray, int]:
    """Solve ``matrix @ x = loads``; return some rows of x, (local, n_loads), and where they start.

    Collective on comm. The right-hand sides are solved together by the factored matrix, or one
    after another where the preconditioner is not a factorisation. Which rows of x a rank gets is
    the factorisation's choice (ScaLAPACK shares them out anew).

    Raises
    ------
    ComputationError : the factorisation failed, or the residual is too large.
    InputError : PETSc does not accept an option.
    """
    local, n_loads = rows.loads.shape
    matrix = _matrix(rows.matrix, (local, rows.matrix.shape[1]), comm)
    # PETSc shares the columns of the right-hand sides out, ScaLAPACK wants one a rank at least
    columns = max(n_loads, comm.size)
    padded = np.zeros((local, columns), order="F")
    padded[:, :n_loads] = rows.loads
    loads = _matrix(padded, (PETSc.DECIDE, columns), comm)
    ksp = PETSc.KSP().create(comm)
    ksp.setOptionsPrefix(BEM_PREFIX)
    ksp.setOperators(matrix)
    ksp.setType("preonly")
    pc = ksp.getPC()
    pc.setType("lu" if comm.size == 1 or has_scalapack() else "redundant")
    owned = [matrix, loads, ksp, pc]
    try:
        set_from_options(ksp, BEM_PREFIX)
        block_cyclic = comm.size > 1 and pc.getType() == "lu"
        if block_cyclic:
            distributed = PETSc.Mat()
            matrix.convert("scalapack", distributed)
            owned.append(distributed)
            ksp.setOperators(distributed)
            pc.setFactorSolverType("scalapack")
        ksp.setUp()
        if pc.getType() in ("lu", "cholesky"):
            ksp.viewFromOptions("-ksp_view")
            factor = pc.getFactorMatrix()
            owned.append(factor)
            if block_cyclic:
                right = PETSc.Mat()
                loads.convert("scalapack", right)
                owned.append(right)
            else:
                right = loads
            answer = right.duplicate()
            owned.append(answer)
            factor.matSolve(right, answer)
            if block_cyclic:
                rowwise = PETSc.Mat()
                answer.convert("dense", rowwise)
                owned.append(rowwise)
                answer = rowwise
            x = np.array(answer.getDenseArray()[:, :n_loads], order="F")
            start = answer.getOwnershipRange()[0]
        else:
            x, start = np.empty_like(rows.loads), rows.start
            right_vec, answer_vec = matrix.createVecLeft(), matrix.createVecRight()
            owned += [right_vec, answer_vec]
            for j in range(n_loads):
                right_vec.setArray(rows.loads[:, j])
                ksp.solve(right_vec, answer_vec)
                if ksp.getConvergedReason() < 0:
                    raise ComputationError(
                        f"boundary element system: right-hand side {j} did not converge "
                        f"(KSP reason {ksp.getConvergedReason()}, "
                        f"residual {ksp.getResidualNorm():.2e})"
                    )
                x[:, j] = answer_vec.getArray(readonly=True)
    except PETSc.Error as error:
        raise ComputationError(
            f"boundary element system: factorisation failed (PETSc error {error.ierr})"
        ) from error
    finally:
        # petsc4py would put aside for later whatever it held last, factors too
        ksp.reset()
        for item in reversed(owned):
            item.destroy()
    _check_residual(rows, x, start, comm)
    return x, start


def _check_residual(rows: Rows, x: FloatArray, start: int, comm: MPI.Comm) -> None:
    """Raise unless the sum of all right-hand sides is solved. Collective on comm."""
    total = np.zeros(rows.matrix.shape[1])
    total[start : start + len(x)] = x.sum(axis=1)
    comm.Allreduce(MPI.IN_PLACE, total, MPI.SUM)
    defect = np.abs(rows.matrix @ total - rows.loads.sum(axis=1))
    size = np.empty_like(defect)
    for first in range(0, len(size), 64):  # no copy of the whole
        part = slice(first, first + 64)
        size[part] = np.abs(rows.matrix[part]) @ np.abs(total)
    worst = float((defect / np.maximum(size, 1e-300)).max(initial=0.0))
    worst = max(comm.allgather(worst if np.isfinite(total).all() else np.inf))
    if not worst <= RESIDUAL_TOLERANCE:
        raise ComputationError(
            f"boundary element system: relative residual {worst:.1e} is above "
            f"{RESIDUAL_TOLERANCE:.0e} (KSP and PC of -{BEM_PREFIX} options must solve, not only "
            "precondition)"
        )
