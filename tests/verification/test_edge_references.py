"""Stored fine solutions: made again on coarser meshes, and what is read of them."""

from dataclasses import replace

import edge_references as script
import numpy as np
import pytest
from mpi4py import MPI

from ringwear_par.cases.case import Stepping
from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.history.elastic.bodies import young
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.observers.trace import trace
from ringwear_par.verification.faces import finite_element_errors, pressure_errors
from ringwear_par.verification.fine import (
    CONTACT,
    FORCE,
    RINGS,
    SORTS,
    SPEED,
    TIMES,
    FineSolution,
    K,
    contact_line,
    ring_case,
    ring_means,
    stored,
)

pytestmark = pytest.mark.serial


@pytest.mark.parametrize(
    ("name", "wear"),
    [("soft on stiff", 5e-7), ("flush, equal moduli", 2e-7), ("cones of 5 degrees", 3e-6)],
)
def test_coarser_meshes_make_the_stored_solutions_again(name, wear):
    """And come nearer to them with each refinement."""
    known = stored(name)
    found = [
        script.differences(script.fine_solutions(Mesh(n, grading=3.0), [name])[name], known)
        for n in (64, 128)
    ]
    coarse, fine = found
    assert fine["approach"] < 5e-7
    assert fine["inside"] < 2e-3
    assert fine["wear"] < wear  # mm
    assert all(coarse[key] > 3.0 * fine[key] for key in ("approach", "inside", "wear"))


def test_stored_wear_is_of_all_the_force():
    for name in SORTS:
        known = stored(name)
        assert known.line.area @ known.pressure == pytest.approx(FORCE, rel=1e-6)
        assert list(known.wear) in ([], list(TIMES))
        oblique = 1.0 / np.cos(np.radians(SORTS[name].degrees))
        for time, wear in known.wear.items():  # worn volume / k = dissipated energy
            power = 0.1 * SPEED * known.line.arm * known.pressure * oblique
            least, most = 0.9 * power.min(), 1.1 * power.max()
            assert least * K * time < wear.min() <= wear.max() < most * K * time


def test_exact_in_time_is_what_short_steps_come_to():
    """The package's own collocated compliance on both sides, so that only time differs."""
    case = ring_case(SORTS["paper"], Mesh(32))
    pair = assemble(case, MPI.COMM_SELF)
    compliance = pair.compliance(young(case))
    exact = script.fine_solution(case, compliance.collocated, compliance.obliquity)
    adaptive = replace(case, time=replace(case.time, tolerance=1e-9))
    worn = trace(adaptive, MPI.COMM_SELF, pair=pair).last.wear[0]
    assert worn == pytest.approx(exact.wear[200.0], abs=1e-7)
    errors = []
    for steps in (100, 200):
        stepping = Stepping("implicit", 1.0 / steps, steps)
        worn = trace(replace(case, time=stepping), MPI.COMM_SELF, pair=pair).last.wear[0]
        errors.append(np.abs(worn - exact.wear[1.0]).max())
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)


def test_lift_off_is_found():
    """Cones of 10 degrees at their outer edge; no pressure is below zero, no gap closed there."""
    case = ring_case(SORTS["cones of 10 degrees"], Mesh(64))
    pair = assemble(case, MPI.COMM_SELF)
    matrix = pair.compliance(young(case)).collocated
    p, approach = script.unworn(case, matrix)
    apart = p == 0.0
    assert apart[-1]
    assert 1 < apart.sum() < 30
    assert (p >= 0.0).all()
    assert (matrix @ p)[apart].max() < 0.0 or (matrix @ p - approach)[apart].min() >= 0.0
    assert case.line.area @ p == pytest.approx(FORCE)


@pytest.mark.parametrize("grading", [1.5, 2.5, 3.0])
def test_ring_means_of_a_singular_field(grading):
    """(r - a)^-0.4: exact on nested meshes, of third order or better on others."""

    def integral(r):  # of 2 pi r (r - a)^-0.4, by s = r - a
        s = r - CONTACT[0]
        return 2.0 * np.pi * (s**1.6 / 1.6 + CONTACT[0] * s**0.6 / 0.6)

    def means(edges):
        return np.diff(integral(edges)) / (np.pi * np.diff(edges**2))

    mesh, nested = Mesh(128, grading=grading), Mesh(32, grading=grading)
    field = means(contact_line(CONTACT, mesh).edges)
    coarse = contact_line(CONTACT, nested).edges
    assert ring_means(mesh, field, coarse) == pytest.approx(means(coarse), rel=1e-9)
    radii = CONTACT[0] + np.array([0.05, 0.1, 0.3, 1.0, 2.9, 3.0])
    assert ring_means(mesh, field, radii) == pytest.approx(means(radii), rel=2e-4)


def test_wrong_pressures_are_told():
    known = stored("flush")
    right = finite_element_errors("flush", RINGS, known.pressure, known.approach)
    assert max(right.values()) < 3e-4
    wrong = known.pressure.copy()
    wrong[:3] *= 0.5  # as the symmetric part alone has it
    found = finite_element_errors("flush", RINGS, wrong, known.approach)
    assert found["ring means"] > 3e-3
    assert pressure_errors(wrong, known).max() == pytest.approx(0.5)
    assert script.told(found, script.TO_FINITE_ELEMENTS).count("!") == 2
    distance = script.from_where(known, wrong, 0.05)
    assert distance == pytest.approx(known.line.r[2] - CONTACT[0])


def test_table_has_a_row_for_each_mesh():
    fine: dict[str, FineSolution] = {"flush": stored("flush")}
    rows = script.table(fine, sizes=(16, 32)).splitlines()
    assert len(rows) == 4
    coarse, better = ([float(x) for x in row.split("|")[4:-1]] for row in rows[2:])
    assert coarse[0] > 4.0 * better[0] > 0.0
    assert all(a >= b for a, b in zip(coarse[:5], better[:5], strict=True))
