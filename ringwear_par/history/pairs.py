"""What is assembled of a case's bodies."""

import time
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from ringwear_par import kept
from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, need_case
from ringwear_par.elasticity.assembly import load_kernels
from ringwear_par.elasticity.boundary import count_elements
from ringwear_par.elasticity.pair import BodyCost, ContactPair, assemble_pair
from ringwear_par.elasticity.recovery import BoundaryRecovery
from ringwear_par.elasticity.slopes import pair_slope
from ringwear_par.elasticity.solve import solved_whole
from ringwear_par.elasticity.updated import UpdatedGeometry
from ringwear_par.history.bodies import bodies, operator_key


def assemble(case: Case, comm: MPI.Comm | None = None, *, use_kept: bool = True) -> ContactPair:
    """Return the contact pair of a case (equation 5); it serves all of the same ``operator_key``.

    Collective on comm, the world's where none is given. The same on all ranks. Pairs are kept among
    the user's caches (see ``kept``) and read from there, with the same bits.

    Parameters
    ----------
    use_kept : whether the pair may be one that was kept, and is kept; False: it is assembled.

    Raises
    ------
    InputError : no case.
    ComputationError : a factorisation failed.
    """
    need_case(case, "assemble")
    comm = MPI.COMM_WORLD if comm is None else comm
    key = operator_key(case)
    # two unknowns at each of two nodes an element, and one node more from axis to axis
    unknowns = max(
        2 * (1 + len(s.layers)) + 4 * count_elements(s, case.contact, case.mesh)
        for s in case.sections
    )
    use_kept = use_kept and solved_whole(unknowns, comm.size)
    if use_kept and (stacked := kept.read(key, case.line.n, comm)) is not None:
        return from_stacked(case, stacked)
    started = time.perf_counter()
    load_kernels(comm)
    loading = BodyCost(seconds_assembly=time.perf_counter() - started)
    pair = assemble_pair(bodies(case), case.line, case.mesh, comm)
    if use_kept:
        kept.write(key, to_stacked(pair), comm)
    return replace(pair, cost=pair.cost + loading)


def to_stacked(pair: ContactPair) -> FloatArray:
    """Return what has been solved for of both bodies, (2, n + 3, n). Not collective."""
    rest = (pair.twist, pair.force_reaction, pair.torque_reaction)
    return np.concatenate([pair.normal, np.stack(rest, axis=1)], axis=1)


def from_stacked(case: Case, stacked: FloatArray) -> ContactPair:
    """Return the pair of a case that ``to_stacked`` was given. Not collective."""
    n = stacked.shape[2]
    parts = stacked[:, :n], stacked[:, n], stacked[:, n + 1], stacked[:, n + 2]
    slope = pair_slope(case.sections, case.line, case.mesh)
    return ContactPair(case.line, *parts, slope, operator_key(case))


def updated_geometry(case: Case, comm: MPI.Comm) -> UpdatedGeometry:
    """Return the elasticity of a case whose elements follow the wear. Collective on comm."""
    load_kernels(comm)
    lower, upper = (law is not None for law in case.laws)
    return UpdatedGeometry(bodies(case), (lower, upper), case.line, case.mesh, comm)


def boundary_recovery(case: Case, comm: MPI.Comm) -> BoundaryRecovery:
    """Return what makes the whole-boundary fields of a case. Not collective."""
    planes = case.lower.z[1], case.upper.z[0]
    return BoundaryRecovery(bodies(case), case.line, case.mesh, planes, comm)
