"""Boundary element systems over ranks: rows of each rank, one solution whoever factors them."""

import numpy as np
import pytest
from mpi4py import MPI
from paths import PAPER
from petsc4py import PETSc

import ringwear_par as rw
from ringwear_par import verify
from ringwear_par.elasticity.bem import solve
from ringwear_par.elasticity.bem.body import body_zones
from ringwear_par.elasticity.bem.quadrature import quadrature
from ringwear_par.elasticity.bem.systems import Rows, assemble, number_dofs
from ringwear_par.elasticity.mesh import Mesh, contact_line
from ringwear_par.elasticity.sections import Body, Section

pytestmark = pytest.mark.mpi


def test_no_rank_holds_a_whole_matrix(comm):
    section, mesh = Section((20.0, 40.0), 20.0), Mesh(16)
    line = contact_line((28.5, 31.5), mesh, section)
    zones = body_zones(Body(section, 1.0, 0.3, "clamped"), line, mesh)
    systems = assemble(zones, number_dofs(zones), quadrature(1e-6), comm)
    for system in systems:
        local, n = system.matrix.shape
        assert comm.allreduce(local) == n
        assert abs(local - n / comm.size) <= 0.1 * n


@pytest.mark.parametrize("way", ["redundant", "distributed"])
def test_other_factorisations_agree_with_those_of_one_rank(comm, way, monkeypatch):
    """A distributed one is that of large systems, by ScaLAPACK."""
    case, options = rw.read_case(PAPER, {"mesh.contact_elements": 32}), PETSc.Options()
    known = rw.assemble(case, MPI.COMM_SELF)
    if way == "distributed":
        if not solve.has_scalapack():
            pytest.skip("this PETSc has no ScaLAPACK")
        monkeypatch.setattr(solve, "ONE_RANK_LIMIT", 10)
    else:
        options["bem_pc_type"] = way
    try:
        found = rw.assemble(case, comm)
    finally:
        options.delValue("bem_pc_type")
    for name in ("normal", "twist", "force_reaction", "torque_reaction"):
        one, other = getattr(found, name), getattr(known, name)
        assert np.abs(one - other).max() <= 1e-10 * np.abs(other).max()


def test_a_singular_system_fails_on_all_ranks(comm):
    begin, end = (rank * 9 // comm.size for rank in (comm.rank, comm.rank + 1))
    loads = np.ones((end - begin, 2))
    assert solve.solve(Rows(np.eye(9)[begin:end], loads), comm).sum() == 18.0
    with pytest.raises(rw.ComputationError, match="factorisation"):
        solve.solve(Rows(np.zeros((end - begin, 9)), loads), comm)


def test_ranks_pass_all_checks(comm, capsys):
    """Of ``ringwear verify``; one rank prints."""
    verify.verify(comm)
    printed = capsys.readouterr().out
    assert ("10 of 10 checks passed" in printed) == (comm.rank == 0)
    assert bool(printed) == (comm.rank == 0)
