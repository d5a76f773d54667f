"""The default mesh is as accurate as it is said to be, its grading right for pressures at edges."""

import pytest
from mpi4py import MPI
from paths import PAPER

import ringwear_par as rw


def test_the_default_mesh_is_nearly_converged():
    """Of approach and wear at an edge with infinite pressures, against four times the elements."""

    def run(**mesh):
        keys = {"wear.lower.p0": 0.0, "time.steps": 4, "time.step": 5.0}
        case = rw.read_case(PAPER, {**keys, **({"mesh": mesh} if mesh else {})})
        return rw.simulate(case, MPI.COMM_SELF).histories

    found, exact = run(), run(contact_elements=256, grading=3.0)
    assert found["approach"][0] == pytest.approx(exact["approach"][0], rel=3e-5)
    assert found["penetration"][-1] == pytest.approx(exact["penetration"][-1], rel=2.5e-4)
