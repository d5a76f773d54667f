"""Dense systems in PETSc: factorise once, solve for many right-hand sides.

KSP and PC solve them, ``preonly`` and ``lu`` where options with the prefix ``bem_`` say nothing
else. As long as a system is no work for several ranks, it is gathered on one of them and solved on
that rank's own communicator; the ranks share the systems of the two bodies. So numbers are those of
a single rank, to the last bit, on any number of ranks.

Larger systems, and all for which there are options, are solved on the communicator of all ranks:
they are converted to ScaLAPACK's block-cyclic layout where PETSc has that, and otherwise (or with
``-bem_pc_type redundant``) every rank factorises a copy of the whole.
"""

import itertools
from collections.abc import Sequence

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.bem.systems import Rows
from ringwear_par.errors import ComputationError
from ringwear_par.options import BEM_PREFIX, set_from_options
from ringwear_par.parallel import together
from ringwear_par.petsc import PETSc

#: largest residual of a row, relative to the sum of its terms
RESIDUAL_TOLERANCE = 1e-9
#: most unknowns of a system that one rank of several solves: 128 MB, and as much of factors
ONE_RANK_LIMIT = 4000

#: some rows of a solution, (local, n_loads), and the number of the first
Solution = tuple[FloatArray, int]


def has_scalapack() -> bool:
    """Tell whether this PETSc can factorise a distributed dense matrix. Not collective."""
    return bool(PETSc.Sys.hasExternalPackage("scalapack"))


def solved_on_one_rank(unknowns: int, ranks: int) -> bool:
    """Tell whether a system is solved by one rank, without options for PETSc. Not collective."""
    if any(name.startswith(BEM_PREFIX) for name in PETSc.Options().getAll()):
        return False
    return ranks == 1 or unknowns <= ONE_RANK_LIMIT


def solve_systems(systems: Sequence[Rows], comm: MPI.Comm) -> list[Solution]:
    """Solve ``matrix @ x = loads`` of each system; return the rows of x that this rank gets.

    Collective on comm. Which they are is the method's choice: all on one rank, or ScaLAPACK's.

    Raises
    ------
    ComputationError : a factorisation failed, or a residual is too large.
    InputError : PETSc does not accept an option.
    """
    sizes = [system.matrix.shape[1] for system in systems]
    shared = comm.size > 1 and not all(solved_on_one_rank(n, comm.size) for n in sizes)
    parts = list(systems) if shared or comm.size == 1 else _gather(systems, comm)
    solutions, largest = [], 0.0
    with together(comm):
        while parts:
            system = parts.pop(0)  # in memory no longer than needed
            if shared:
                x, start = _solve(system.matrix, system.loads, comm)
            else:
                x, start = _solve_by_zones(system), 0
            largest = max(largest, _residual(system, x, start, comm if shared else MPI.COMM_SELF))
            solutions.append((x, start))
    largest = max(comm.allgather(largest))
    if not largest <= RESIDUAL_TOLERANCE:
        raise ComputationError(
            f"boundary element system: relative residual {largest:.1e} is above "
            f"{RESIDUAL_TOLERANCE:.0e} (KSP and PC of -{BEM_PREFIX} options must solve, not only "
            "precondition)"
        )
    return solutions


def owners(sizes: Sequence[int], ranks: int) -> list[int]:
    """Return which rank solves each system: the largest first, to whom has least to do."""
    work, owner = [0.0] * ranks, [0] * len(sizes)
    for i in sorted(range(len(sizes)), key=lambda i: -sizes[i]):
        owner[i] = work.index(min(work))
        work[owner[i]] += float(sizes[i]) ** 3
    return owner


def _gather(systems: Sequence[Rows], comm: MPI.Comm) -> list[Rows]:
    """Return each system whole on its owner, without rows on other ranks. Collective on comm."""
    owner = owners([system.matrix.shape[1] for system in systems], comm.size)
    whole, requests, blocks = [], [], []
    for system, rank in zip(systems, owner, strict=True):
        counts = comm.allgather(len(system.matrix))
        n = sum(counts) if comm.rank == rank else 0
        arrays = [np.zeros((n, part.shape[1]), order="F") for part in (system.matrix, system.loads)]
        for part, target in zip((system.matrix, system.loads), arrays, strict=True):
            columns = part.shape[1]
            for source, (start, count) in enumerate(
                zip(itertools.accumulate(counts, initial=0), counts, strict=False)
            ):
                if comm.rank == rank and count:
                    block = MPI.DOUBLE.Create_subarray(
                        [n, columns], [count, columns], [start, 0], MPI.ORDER_F
                    ).Commit()
                    blocks.append(block)
                    requests.append(comm.Irecv([target, 1, block], source))
            if len(part):
                requests.append(comm.Isend(np.asfortranarray(part).T, rank))
        whole.append(Rows(arrays[0], arrays[1], 0, system.zones))
    # all of them before the first is solved: a rank that is factoring sends nothing to others
    MPI.Request.Waitall(requests)
    for block in blocks:
        block.Free()
    return whole


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
        from_above = matrix[zone, above]
        columns = np.flatnonzero(from_above.any(axis=0))
        loaded = np.flatnonzero(right.any(axis=0))  # mostly none: the contact is at the first zone
        rights = np.hstack([right[:, loaded], from_above[:, columns]])
        alone, per_unknown = np.hsplit(_solve(block, rights, MPI.COMM_SELF)[0], [len(loaded)])
        eliminated.append((alone, loaded, per_unknown, columns))
        block, right = matrix[above, above].copy(order="F"), loads[above].copy()
        from_zone = matrix[above, zone]
        rows = np.flatnonzero(from_zone.any(axis=0))
        from_zone = from_zone[:, rows]
        block[:, columns] -= from_zone @ per_unknown[rows]
        right[:, loaded] -= from_zone @ alone[rows]
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


def _solve(rows: FloatArray, rights: FloatArray, comm: MPI.Comm) -> Solution:
    """Solve a system by the ranks of comm in PETSc. Collective on comm.

    The right-hand sides are solved together by the factored matrix, or one after another where the
    preconditioner is not a factorisation.

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
            x = np.array(answer.getDenseArray()[:, :n_loads], order="F")
            return x, answer.getOwnershipRange()[0]
        x = np.empty_like(rights)
        right_vec, answer_vec = matrix.createVecLeft(), matrix.createVecRight()
        owned += [right_vec, answer_vec]
        for j in range(n_loads):
            right_vec.setArray(rights[:, j])
            ksp.solve(right_vec, answer_vec)
            if ksp.getConvergedReason() < 0:
                raise ComputationError(
                    f"boundary element system: right-hand side {j} did not converge "
                    f"(KSP reason {ksp.getConvergedReason()}, "
                    f"residual {ksp.getResidualNorm():.2e})"
                )
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


def _residual(system: Rows, x: FloatArray, start: int, comm: MPI.Comm) -> float:
    """Return the largest relative residual of rows, for the sum of all right-hand sides.

    Collective on comm, whose ranks have the rows of the system.
    """
    matrix, loads = system.matrix, system.loads
    total = np.zeros(matrix.shape[1] if comm.size > 1 else len(matrix))
    total[start : start + len(x)] = x.sum(axis=1)
    comm.Allreduce(MPI.IN_PLACE, total, MPI.SUM)
    if not len(matrix):
        return 0.0
    if not np.isfinite(total).all():
        return np.inf
    defect = np.abs(matrix @ total - loads.sum(axis=1))
    size = np.zeros_like(defect)
    for first in range(0, len(total), 64):  # no copy of the whole
        part = slice(first, first + 64)
        size += np.abs(matrix[:, part]) @ np.abs(total[part])
    return float((defect / np.maximum(size, 1e-300)).max(initial=0.0))
