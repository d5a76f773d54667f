"""Dense systems: factorise once, solve for many right-hand sides.

The systems of two bodies are independent. As long as one of them is no work for several ranks, each
is gathered on one rank, which solves it by LAPACK; the ranks share the systems. So numbers are
those of a single rank, to the last bit, on any number of ranks.

Larger systems are factored in PETSc by all ranks together, which convert them to ScaLAPACK's
block-cyclic layout where PETSc has that, and otherwise (or with ``-bem_pc_type redundant``) let
every rank factorise a copy of the whole. The same holds for all systems where there are options for
them: what is asked of PETSc, PETSc does.
"""

import itertools
from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from scipy.linalg.lapack import dgetrf, dgetrs

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.bem.assembly import Rows
from ringwear_par.errors import ComputationError
from ringwear_par.options import BEM_PREFIX, set_from_options
from ringwear_par.petsc import PETSc

#: largest residual of a row, relative to the sum of its terms
RESIDUAL_TOLERANCE = 1e-9
#: most unknowns of a system that one rank of several solves alone: 128 MB, and as much of factors
WHOLE_LIMIT = 4000

#: some rows of a solution, (local, n_loads), and the number of the first
Solution = tuple[FloatArray, int]


def has_scalapack() -> bool:
    """Tell whether this PETSc can factorise a distributed dense matrix. Not collective."""
    return bool(PETSc.Sys.hasExternalPackage("scalapack"))


def _matrix(local: FloatArray, columns: tuple[int, int], comm: MPI.Comm) -> PETSc.Mat:
    matrix = PETSc.Mat().createDense(
        size=((local.shape[0], PETSc.DETERMINE), columns), array=local, comm=comm
    )
    matrix.assemble()
    return matrix


def solved_whole(unknowns: int, ranks: int) -> bool:
    """Tell whether a system is solved by one rank. Not collective."""
    if any(name.startswith(BEM_PREFIX) for name in PETSc.Options().getAll()):
        return False
    return ranks == 1 or unknowns <= WHOLE_LIMIT


def solve_systems(systems: Sequence[Rows], comm: MPI.Comm) -> list[Solution]:
    """Solve ``matrix @ x = loads`` of each system; return the rows of x that this rank gets.

    Collective on comm. Which they are is the method's choice: all on one rank, or ScaLAPACK's.

    Raises
    ------
    ComputationError : a factorisation failed, or a residual is too large.
    InputError : PETSc does not accept an option.
    """
    if all(solved_whole(system.matrix.shape[1], comm.size) for system in systems):
        return _solve_whole(systems, comm)
    return [_solve_distributed(system, comm) for system in systems]


def owners(sizes: Sequence[int], ranks: int) -> list[int]:
    """Return which rank solves each system: the largest first, to whom has least to do."""
    work, owner = [0.0] * ranks, [0] * len(sizes)
    for i in sorted(range(len(sizes)), key=lambda i: -sizes[i]):
        owner[i] = work.index(min(work))
        work[owner[i]] += float(sizes[i]) ** 3
    return owner


def _solve_whole(systems: Sequence[Rows], comm: MPI.Comm) -> list[Solution]:
    """Solve each system on one of the ranks. Collective on comm."""
    owner = owners([system.matrix.shape[1] for system in systems], comm.size)
    gathered = [_gather(*each, comm) for each in zip(systems, owner, strict=True)]
    solutions, worst = [], 0.0
    # all of them first: a rank that is factoring sends nothing to others
    MPI.Request.Waitall([request for *_, requests in gathered for request in requests])
    for system in systems:
        matrix, loads, _ = gathered.pop(0)  # in memory no longer than needed
        x, residual = np.empty((0, system.loads.shape[1])), 0.0
        if len(matrix):
            x, residual = _solve_alone(matrix, loads, system.zones)
        worst = max(worst, residual)
        solutions.append((x, 0))
    _check(worst, comm)
    return solutions


def _solve_alone(
    matrix: FloatArray, loads: FloatArray, zones: Sequence[int]
) -> tuple[FloatArray, float]:
    """Return the solution of a system and its residual. Not collective.

    Zones are coupled to their neighbours alone. They are eliminated one after another, from the one
    at the fixed face on: what it does at given unknowns of the zone above is known.

    Parameters
    ----------
    zones : numbers of the first rows of zones.
    """
    parts = [slice(*ends) for ends in itertools.pairwise([*zones, len(matrix)])]
    block, right = matrix[parts[-1], parts[-1]].copy(), loads[parts[-1]]
    given = []  # of each zone, from the last on: under its own loads, and per unknown above
    for above, own in zip(parts[-2::-1], parts[:0:-1], strict=True):
        acts = matrix[own, above]
        columns = np.flatnonzero(acts.any(axis=0))
        loaded = np.flatnonzero(right.any(axis=0))  # mostly none: the contact is at the first zone
        found = _solve_block(block, np.hstack([right[:, loaded], acts[:, columns]]))
        alone, per_unknown = np.hsplit(found, [len(loaded)])
        given.append((alone, loaded, per_unknown, columns))
        block, right = matrix[above, above].copy(), loads[above].copy()
        reacts = matrix[above, own]
        rows = np.flatnonzero(reacts.any(axis=0))
        reacts = reacts[:, rows]
        block[:, columns] -= reacts @ per_unknown[rows]
        right[:, loaded] -= reacts @ alone[rows]
    x = [_solve_block(block, right)]
    for alone, loaded, per_unknown, columns in reversed(given):
        below = -per_unknown @ x[-1][columns]
        below[:, loaded] += alone
        x.append(below)
    solution = np.concatenate(x)
    return solution, _residual(matrix, loads, solution.sum(axis=1))


def _solve_block(matrix: FloatArray, rights: FloatArray) -> FloatArray:
    """Return the solution of a dense system whose matrix may be written to; NaN if it failed."""
    # row by row, the matrix is the transpose of what LAPACK reads column by column
    factor, pivots, failed = dgetrf(matrix.T, overwrite_a=True)
    if not failed:
        x, failed = dgetrs(factor, pivots, rights, trans=1)
    return np.full_like(rights, np.nan) if failed else x


def _gather(
    system: Rows, owner: int, comm: MPI.Comm
) -> tuple[FloatArray, FloatArray, list[MPI.Request]]:
    """Begin to gather a system on its owner; others get no rows. Collective on comm."""
    if comm.size == 1:
        return system.matrix, system.loads, []
    rows = comm.allgather(len(system.matrix))
    whole, requests = [], []
    for local in (system.matrix, system.loads):
        width = local.shape[1]
        target = np.empty((sum(rows) if comm.rank == owner else 0, width))
        counts = [n * width for n in rows]
        requests.append(comm.Igatherv(local, [target, counts], owner))
        whole.append(target)
    return whole[0], whole[1], requests


def _solve_distributed(rows: Rows, comm: MPI.Comm) -> Solution:
    """Solve a system by all ranks in PETSc. Collective on comm.

    The right-hand sides are solved together by the factored matrix, or one after another where the
    preconditioner is not a factorisation.
    """
    local, n_loads = rows.loads.shape
    matrix = _matrix(np.asfortranarray(rows.matrix), (local, rows.matrix.shape[1]), comm)
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
    total = np.zeros(rows.matrix.shape[1])
    total[start : start + len(x)] = x.sum(axis=1)
    comm.Allreduce(MPI.IN_PLACE, total, MPI.SUM)
    _check(_residual(rows.matrix, rows.loads, total), comm)
    return x, start


def _residual(matrix: FloatArray, loads: FloatArray, total: FloatArray) -> float:
    """Return the worst relative residual of rows, for the sum of all right-hand sides."""
    if not np.isfinite(total).all():
        return np.inf
    defect = np.abs(matrix @ total - loads.sum(axis=1))
    size = np.empty_like(defect)
    for first in range(0, len(size), 64):  # no copy of the whole
        part = slice(first, first + 64)
        size[part] = np.abs(matrix[part]) @ np.abs(total)
    return float((defect / np.maximum(size, 1e-300)).max(initial=0.0))


def _check(worst: float, comm: MPI.Comm) -> None:
    """Raise unless the residuals of all ranks are small. Collective on comm."""
    worst = max(comm.allgather(worst))
    if not worst <= RESIDUAL_TOLERANCE:
        raise ComputationError(
            f"boundary element system: relative residual {worst:.1e} is above "
            f"{RESIDUAL_TOLERANCE:.0e} (KSP and PC of -{BEM_PREFIX} options must solve, not only "
            "precondition)"
        )
