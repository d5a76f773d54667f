"""What is assembled of a case's bodies."""

from mpi4py import MPI

from ringwear_par.cases.case import Case, need_case
from ringwear_par.elasticity.assembly import load_kernels
from ringwear_par.elasticity.pair import ContactPair, assemble_pair
from ringwear_par.elasticity.recovery import BoundaryRecovery
from ringwear_par.elasticity.updated import UpdatedGeometry
from ringwear_par.history.bodies import bodies


def assemble(case: Case, comm: MPI.Comm | None = None) -> ContactPair:
    """Return the contact pair of a case, eq. (5); it serves all of the same ``operator_key``.

    Collective on comm, the world's where none is given. The same on all ranks.

    Raises
    ------
    InputError : no case.
    ComputationError : a factorisation failed.
    """
    need_case(case, "assemble")
    comm = MPI.COMM_WORLD if comm is None else comm
    load_kernels(comm)
    return assemble_pair(bodies(case), case.line, case.mesh, comm)


def updated_geometry(case: Case, comm: MPI.Comm) -> UpdatedGeometry:
    """Return the elasticity of a case whose elements follow the wear. Not collective."""
    lower, upper = (law is not None for law in case.laws)
    return UpdatedGeometry(bodies(case), (lower, upper), case.line, case.mesh, comm)


def boundary_recovery(case: Case, comm: MPI.Comm) -> BoundaryRecovery:
    """Return what makes the whole-boundary fields of a case. Not collective."""
    planes = case.lower.z[1], case.upper.z[0]
    return BoundaryRecovery(bodies(case), case.line, case.mesh, planes, comm)
