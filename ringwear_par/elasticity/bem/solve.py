"""Dense systems in PETSc: factorise once, solve for many right-hand sides.

KSP and PC solve them, ``preonly`` and ``lu`` where options with the prefix ``bem_`` say nothing
else. A system that is no work for several ranks is solved by each of them alone, so numbers are
those of a single rank, to the last bit, on any number of ranks. Larger systems, and all for which
there are options, are matrices of all ranks: they are converted to ScaLAPACK's block-cyclic layout
where PETSc has that, and otherwise (or with ``-bem_pc_type redundant``) every rank factorises a
copy of the whole.
"""

import itertools

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.bem.systems import Rows
from ringwear_par.errors import ComputationError
from ringwear_par.options import BEM_PREFIX, set_from_options
from ringwear_par.petsc import PETSc

#: largest residual, relative to the norms of matrix and solution
RESIDUAL_TOLERANCE = 1e-9
#: most unknowns of a system that every rank solves by itself: 128 MB, and as much of factors
ONE_RANK_LIMIT = 4000


def has_scalapack() -> bool:
    """Tell whether this PETSc can factorise a distributed dense matrix. Not collective."""
    return bool(PETSc.Sys.hasExternalPackage("scalapack"))


def solved_on_one_rank(unknowns: int, ranks: int) -> bool:
    """Tell whether a rank solves a system by itself, without options for PETSc. Not collective."""
    if any(name.startswith(BEM_PREFIX) for name in PETSc.Options().getAll()):
        return ranks == 1
    return ranks == 1 or unknowns <= ONE_RANK_LIMIT


def solve(system: Rows, comm: MPI.Comm) -> FloatArray:
    """Return the solution (n, n_loads) of ``matrix @ x = loads``, on every rank of comm.

    Collective on comm, whose ranks have the rows of the system.

    Raises
    ------
    ComputationError : a factorisation failed, or the residual is too large.
    InputError : PETSc does not accept an option.
    """
    if comm.size == 1:
        x = _solve_by_zones(system)
    else:
        x = np.zeros((system.matrix.shape[1], system.loads.shape[1]))
        local, start = _solve(system.matrix, system.loads, comm)
        x[start : start + len(local)] = local
        comm.Allreduce(MPI.IN_PLACE, x, MPI.SUM)  # each entry is known to one rank: it is exact
    total = x.sum(axis=1)  # of all right-hand sides
    defect = np.linalg.norm(system.matrix @ total - system.loads.sum(axis=1))
    size = np.linalg.norm(system.matrix) * np.linalg.norm(total) + 1e-300
    residual = float(np.max(comm.allgather(float(defect / size))))
    if not residual <= RESIDUAL_TOLERANCE:
        raise ComputationError(
            f"boundary element system: relative residual {residual:.1e} is above "
            f"{RESIDUAL_TOLERANCE:.0e} (KSP and PC of -{BEM_PREFIX} options must solve, not only "
            "precondition)"
        )
    return x


def _solve_by_zones(system: Rows) -> FloatArray:
    """Return the solution of a whole system. Not collective.

    Zones are coupled to their neighbours alone. They are eliminated one after another, from the one
    at the fixed face on: its answer to given unknowns of the zone above is known.
    """
    matrix, loads = system.matrix, system.loads
    if not len(matrix):
        return np.empty_like(loads)
    parts = [slice(*ends) for ends in itertools.pairwise([*system.zones, len(matrix)])]
    block, right = matrix[parts[-1], parts[-1]], loads[parts[-1]]
    eliminated = []  # of each zone, from the last on: under its own loads, and per unknown above
    for above, zone in zip(parts[-2::-1], parts[:0:-1], strict=True):
        from_above, from_zone = matrix[zone, above], matrix[above, zone]
        columns, rows = (np.flatnonzero(of.any(axis=0)) for of in (from_above, from_zone))
        loaded = np.flatnonzero(right.any(axis=0))  # mostly none: the contact is at the first zone
        rights = np.hstack([right[:, loaded], from_above[:, columns]])
        alone, per_unknown = np.hsplit(_solve(block, rights, MPI.COMM_SELF)[0], [len(loaded)])
        eliminated.append((alone, loaded, per_unknown, columns))
        block, right = matrix[above, above].copy(order="F"), loads[above].copy()
        block[:, columns] -= from_zone[:, rows] @ per_unknown[rows]
        right[:, loaded] -= from_zone[:, rows] @ alone[rows]
    x = [_solve(block, right, MPI.COMM_SELF)[0]]
    for alone, loaded, per_unknown, columns in reversed(eliminated):
        below = -per_unknown @ x[-1][columns]
        below[:, loaded] += alone
        x.append(below)
    return np.concatenate(x)


def _dense(local: FloatArray, columns: tuple[int, int], comm: MPI.Comm) -> PETSc.Mat:
    """Return a PETSc matrix around the rows of this rank, copied unless column-major."""
    matrix = PETSc.Mat().createDense(
        size=((local.shape[0], PETSc.DETERMINE), columns), array=local, comm=comm
    )
    matrix.assemble()
    return matrix


def _solve(rows: FloatArray, rights: FloatArray, comm: MPI.Comm) -> tuple[FloatArray, int]:
    """Solve a system by the ranks of comm; return some rows and the number of the first.

    Collective on comm. The right-hand sides are solved together by the factored matrix, or one
    after another where the preconditioner is not a factorisation.

    Parameters
    ----------
    rows, rights : (local, n) and (local, n_loads) float, of this rank.
    """
    local, n_loads = rights.shape
    # PETSc shares the columns of the right-hand sides out, ScaLAPACK wants one a rank at least
    columns = max(n_loads, comm.size)
    padded = np.zeros((local, columns), order="F")
    padded[:, :n_loads] = rights
    matrix = _dense(rows, (local, rows.shape[1]), comm)
    loads = _dense(padded, (PETSc.DECIDE, columns), comm)
    ksp = PETSc.KSP().create(comm)
    ksp.setOptionsPrefix(BEM_PREFIX)
    ksp.setOperators(matrix)
    ksp.setType("preonly")
    pc = ksp.getPC()
    pc.setType("lu" if comm.size == 1 or has_scalapack() else "redundant")
    owned = [matrix, loads, ksp, pc]

    def converted(source: PETSc.Mat, kind: str) -> PETSc.Mat:
        target = PETSc.Mat()
        source.convert(kind, target)
        owned.append(target)
        return target

    try:
        set_from_options(ksp, BEM_PREFIX)
        block_cyclic = comm.size > 1 and pc.getType() == "lu"
        if block_cyclic:
            ksp.setOperators(converted(matrix, "scalapack"))
            pc.setFactorSolverType("scalapack")
        ksp.setUp()
        if pc.getType() in ("lu", "cholesky"):
            ksp.viewFromOptions("-ksp_view")
            factor = pc.getFactorMatrix()
            right = converted(loads, "scalapack") if block_cyclic else loads
            answer = right.duplicate()
            owned += [factor, answer]
            factor.matSolve(right, answer)
            if block_cyclic:
                answer = converted(answer, "dense")
            return answer.getDenseArray()[:, :n_loads].copy(), answer.getOwnershipRange()[0]
        x = np.empty_like(rights)
        right_vec, answer_vec = matrix.createVecLeft(), matrix.createVecRight()
        owned += [right_vec, answer_vec]
        for j in range(n_loads):
            right_vec.setArray(rights[:, j])
            ksp.solve(right_vec, answer_vec)
            x[:, j] = answer_vec.getArray(readonly=True)
        return x, matrix.getOwnershipRange()[0]
    except PETSc.Error as error:
        raise ComputationError(
            f"boundary element system: factorisation failed (PETSc error {error.ierr})"
        ) from error
    finally:
        # petsc4py would put aside for later whatever it held last, factors too
        ksp.reset()
        for item in reversed(owned):
            item.destroy()
