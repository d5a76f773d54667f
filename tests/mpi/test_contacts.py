"""Contacts whose rows are shared out among ranks."""

import numpy as np
import pytest
from contact_problems import drawn
from mpi4py import MPI
from parts import Mesh, TaoContact
from reference_cases import paper_case

import ringwear_par as rw
from ringwear_par.history import loop
from ringwear_par.history.elastic import assemble

pytestmark = pytest.mark.mpi

ALONE = MPI.COMM_SELF


@pytest.mark.parametrize("by_force", [True, False])
def test_tao_finds_the_same_on_any_number_of_ranks(comm, by_force):
    """By GMRES on rows of each rank, by factors on one; all ranks hold the same bits."""
    case = paper_case(Mesh(32))
    block, (gap, load, step) = drawn((case, assemble(case, ALONE)), 20, 1, None, by_force)
    found = []
    for one in (comm, ALONE):
        with TaoContact(block.compliance, by_force, one) as tao:
            found.append(tao.solve(gap, load, step, np.zeros_like(gap), np.zeros_like(load)))
    shared, alone = found
    assert not shared.failed.any()
    assert not alone.failed.any()
    largest = alone.pressure.max(axis=1)
    assert (np.abs(shared.pressure - alone.pressure).max(axis=1) < 1e-7 * largest).all()
    assert len(set(comm.allgather(shared.pressure.tobytes()))) == 1


@pytest.mark.parametrize("scheme", ["implicit", "adaptive"])
def test_a_history_whose_contacts_all_ranks_share(comm, monkeypatch, scheme):
    monkeypatch.setattr(loop, "SHARED", 1)
    time = {"scheme": "adaptive", "end": 20.0} if scheme == "adaptive" else {
        "scheme": "implicit", "step": 2.0, "steps": 6}  # fmt: skip
    case = rw.read_case("scripts/cases/paper.toml", {"mesh.contact_elements": 32, "time": time})
    shared, alone = rw.simulate(case, comm), rw.simulate(case, ALONE)
    assert shared.histories["time"] == pytest.approx(alone.histories["time"], rel=1e-6)
    for name in ("wear_lower", "pressure"):
        one, other = shared.profiles[name], alone.profiles[name]
        assert np.abs(one - other).max() < 1e-5 * np.abs(other).max()
    bits = shared.profiles["wear_lower"].tobytes()
    assert len(set(comm.allgather(bits))) == 1
