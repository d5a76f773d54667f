"""Elasticity that is assembled of a case's bodies: contact pairs, updated geometry, fields."""

import time
from dataclasses import replace
from functools import partial

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, need_case
from ringwear_par.elasticity import pair_cache
from ringwear_par.elasticity.bem.assembly import load_kernels
from ringwear_par.elasticity.bem.body import BodyCost
from ringwear_par.elasticity.bem.boundary import count_elements
from ringwear_par.elasticity.bem.pair import ContactPair, assemble_pair
from ringwear_par.elasticity.bem.solve import solved_on_one_rank
from ringwear_par.elasticity.bem.updated import UpdatedGeometry
from ringwear_par.elasticity.mesh import pair_slope
from ringwear_par.elasticity.stress.boundary_recovery import BoundaryRecovery
from ringwear_par.history.elastic.bodies import bodies, operator_key

#: allowed relative error of reciprocity and equilibrium of a cached pair: several times that of
#: eight elements, 0.02, and 200 times that of 64
_MOST_DEFECT = 0.1


def assemble(case: Case, comm: MPI.Comm | None = None, *, use_kept: bool = True) -> ContactPair:
    """Return the contact pair of a case (equation 5), which serves all of one ``operator_key``.

    Collective on comm, the world's where none is given. The same on all ranks. Pairs are kept among
    the user's caches (see ``pair_cache``) and read from there, with the same bits.

    Parameters
    ----------
    use_kept : whether the pair may be one that was kept, and is kept; False: it is assembled.

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
    key = operator_key(case)
    # two unknowns at each of two nodes an element, and one node more from axis to axis
    unknowns = max(
        2 * (1 + len(s.layers)) + 4 * count_elements(s, case.contact, case.mesh)
        for s in case.sections
    )
    use_kept = use_kept and solved_on_one_rank(unknowns, comm.size)
    if use_kept:
        stacked = pair_cache.read(key, case.line.n, comm, partial(is_sound, case.line.area))
        if stacked is not None:
            return from_stacked(case, stacked)
    started = time.perf_counter()
    load_kernels(comm)
    loading = BodyCost(seconds_assembly=time.perf_counter() - started)
    pair = assemble_pair(bodies(case), case.line, case.mesh, comm)
    if use_kept and is_sound(pair.line.area, to_stacked(pair)):
        pair_cache.write(key, to_stacked(pair), comm)
    return replace(pair, cost=pair.cost + loading)


def to_stacked(pair: ContactPair) -> FloatArray:
    """Return the responses of both bodies, stacked, (2, n + 3, n). Not collective."""
    rest = (pair.twist, pair.force_reaction, pair.torque_reaction)
    return np.concatenate([pair.normal, np.stack(rest, axis=1)], axis=1)


def is_sound(area: FloatArray, stacked: FloatArray) -> bool:
    """Tell whether numbers can be those of a pair, see ``to_stacked``. Not collective.

    They are finite; an element gives way under its own pressure and is twisted by its own shear;
    Betti's reciprocity makes ``diag(area) C`` symmetric and equilibrium the reaction to each unit
    pressure its area, which both hold better the finer the mesh.

    Parameters
    ----------
    area : (n,) mm^2, of the contact elements.
    """
    n = len(area)
    normal, twist, reaction = stacked[:, :n], stacked[:, n], stacked[:, n + 1]
    if not np.isfinite(stacked).all():
        return False
    weighted = area[:, None] * normal
    defect = np.abs(weighted - weighted.transpose(0, 2, 1)).max(axis=(1, 2))
    return bool(
        (np.diagonal(normal, axis1=1, axis2=2) > 0.0).all()
        and (twist > 0.0).all()
        and (defect <= _MOST_DEFECT * np.abs(weighted).max(axis=(1, 2))).all()
        and (np.abs(reaction - area) <= _MOST_DEFECT * area).all()
    )


def from_stacked(case: Case, stacked: FloatArray) -> ContactPair:
    """Return the pair of a case from its responses, see ``to_stacked``. Not collective."""
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
    """Return the recovery of the whole-boundary fields of a case. Not collective."""
    planes = case.lower.z[1], case.upper.z[0]
    return BoundaryRecovery(bodies(case), case.line, case.mesh, planes, comm)
