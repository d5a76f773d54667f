"""Elasticity that is assembled of a case's bodies: contact pairs, and fields on boundaries."""

from collections.abc import Hashable

from mpi4py import MPI

from ringwear_par.cases.case import Case, need_case
from ringwear_par.elasticity.bem.pair import ContactPair, assemble_pair
from ringwear_par.elasticity.mesh import pair_key
from ringwear_par.elasticity.sections import Body, Material
from ringwear_par.elasticity.stress.recovery import BoundaryRecovery


def bodies(case: Case) -> tuple[Body, Body]:
    """Return lower and upper. Not collective."""
    lower, upper = (
        Body(
            case.section(ring), ring.young, ring.poisson, ring.grip,
            tuple(Material(layer.young, layer.poisson) for layer in ring.layers),
        )
        for ring in case.rings
    )  # fmt: skip
    return lower, upper


def operator_key(case: Case) -> Hashable:
    """Return the key of the contact pair of a case; equal for cases that can share it."""
    return pair_key(bodies(case), case.contact, case.mesh)


def assemble(case: Case, comm: MPI.Comm | None = None) -> ContactPair:
    """Return the contact pair of a case (equation 5), which serves all of one ``operator_key``.

    Collective on comm, the world's where none is given. The same on all ranks.

    Returns
    -------
    ContactPair : for ``simulate(case, pair=...)``.

    Raises
    ------
    InputError : no case.
    ComputationError : a factorisation failed.

    Examples
    --------
    >>> import ringwear_par as rw
    >>> case = rw.read_case("scripts/cases/paper.toml")
    >>> pair = rw.assemble(case)
    >>> pair
    <ContactPair: 64 contact elements, r = 28.5 to 31.5 mm>
    >>> soft = rw.simulate(case.replace({"lower.young": "5 GPa"}), pair=pair)
    """
    need_case(case, "assemble")
    comm = MPI.COMM_WORLD if comm is None else comm
    return assemble_pair(bodies(case), case.line, case.mesh, comm)


def boundary_recovery(case: Case, comm: MPI.Comm, *, fine: bool = False) -> BoundaryRecovery:
    """Return the recovery of the whole-boundary fields of a case. Not collective."""
    planes = case.lower.z[1], case.upper.z[0]
    return BoundaryRecovery(bodies(case), case.line, case.mesh, planes, comm, fine=fine)
