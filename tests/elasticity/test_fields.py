"""Fields on whole boundaries: equilibrium, bodies that meet, exact fields, what is stored when."""

import numpy as np
import pytest
from parts import boundary_recovery, run_case
from paths import CASES, PAPER

import ringwear_par as rw
from ringwear_par.elasticity.stress.fields import FACES

FIELDS = CASES / "fields.toml"
SMALL = ["mesh.contact_elements=16", "time.steps=20", "output.boundary=all"]
#: elements that follow the wear often
MOVING = ["mesh.geometry=updated", "mesh.geometry_tolerance=0.001", "wear.lower.k=1e-6"]


def contact_of(fields):
    """Elements of the contact line by increasing radius, and their middle nodes."""
    elements = np.flatnonzero(fields.face == FACES.index("contact"))
    middle = fields.elements[elements, 1]
    order = np.argsort(fields.nodes[middle, 0])
    return elements[order], middle[order]


def weights(fields):
    """Area and moment of every element about the axis, mm^2 and mm^3."""
    a, b = (fields.nodes[fields.elements[:, i]] for i in (0, 2))
    length = np.hypot(*(b - a).T)
    ra, rb = a[:, 0], b[:, 0]
    return np.pi * (ra + rb) * length, 2 * np.pi / 3 * length * (ra**2 + ra * rb + rb**2)


@pytest.mark.parametrize(
    ("case", "overrides"),
    [
        ("fields.toml", []),
        ("chamfer.toml", ["output.boundary=all", "time.steps=4", "output.every=2"]),
        ("fields.toml", ["wear.upper={law='threshold', k=1e-8}", "upper.grip=platen"]),
        ("fields.toml", MOVING),
    ],
)
def test_equilibrium_and_bodies_that_meet(case, overrides, tmp_path, comm):
    path = tmp_path / "run.h5"
    run_case(CASES / case, path, overrides, comm=comm)
    result = rw.open_result(path)
    shape = result.last_state.meshed
    line = rw.read_case(CASES / case, overrides).line
    assert [b.time for b in result.boundary] == result.histories["time"].tolist()
    for row, state in enumerate(result.boundary):
        force, torque = result.histories["force"][row], result.histories["torque"][row]
        for sign, body in zip((1, -1), state.bodies, strict=True):
            area, moment = weights(body)
            fixed = body.face == FACES.index("fixed")
            assert abs(area @ body.traction[:, 1]) < 1e-4 * force
            assert abs(moment @ body.traction[:, 2]) < 1e-4 * torque
            held = (area * body.traction[:, 1])[fixed], (moment * body.traction[:, 2])[fixed]
            assert held[0].sum() == pytest.approx(sign * force, rel=1e-4)
            assert held[1].sum() == pytest.approx(-sign * torque, rel=1e-4)
            assert not body.traction[np.isin(body.face, (0, 3, 4))].any()
            assert not body.displacement[body.elements[fixed], 2].any()
        p = result.profiles["pressure"][row]
        height = []
        for body in state.bodies:
            elements, middle = contact_of(body)
            assert np.array_equal(body.pressure[elements], p)
            assert body.nodes[middle, 0] == pytest.approx(line.r, rel=1e-14)
            height.append(body.nodes[middle, 1] + body.displacement[middle, 1])
        gap = height[1] - height[0]
        if shape is not None and row < len(result.boundary) - 1:
            assert shape.max() > 0.005
            continue  # with other elements
        approach = result.histories["approach"][row]
        if shape is None:
            assert np.abs(gap - result.profiles["gap"][row]).max() < 1e-7 * approach
        assert np.abs(gap[p > 0]).max() < 2e-4 * approach
        assert (result.profiles["gap"][row][p > 0] < 1e-9).all()


def test_bars_shorten_as_they_should(comm):
    """Equal tubes without Poisson's effect under uniform pressure: u_z is linear, exactly."""
    tube = [f"{ring}.{key}" for ring in ("lower", "upper")
            for key in ("r=[20.0,40.0]", "young=1e4", "poisson=0")]  # fmt: skip
    case = rw.read_case(PAPER, [*SMALL, *tube])
    strain = 80.0 / 1e4
    recovery = boundary_recovery(case, comm)
    lower, upper = recovery.fields(
        np.full(16, 80.0), 40.0 * strain, case.friction, np.zeros((2, 16))
    )
    for body in (lower, upper):
        # the fixed top comes down by the approach: both are one bar, fixed at z = 0
        expected = -strain * body.nodes[:, 1]
        assert body.displacement[:, 1] == pytest.approx(expected, abs=1e-6 * 40 * strain)
        assert np.abs(body.displacement[:, 0]).max() < 1e-6 * strain * 40
    assert lower.traction[lower.face == 2, 1] == pytest.approx(80.0, rel=1e-4)
    assert upper.traction[upper.face == 2, 1] == pytest.approx(-80.0, rel=1e-4)
    # lower is dragged along by the upper body's rotation, upper held back
    assert lower.traction[lower.face == 1] == pytest.approx(np.tile([0, -80.0, 8.0], (16, 1)))
    assert upper.traction[upper.face == 1] == pytest.approx(np.tile([0, 80.0, -8.0], (16, 1)))
    assert (lower.displacement[contact_of(lower)[1], 2] > 0).all()
    assert (upper.displacement[contact_of(upper)[1], 2] < 0).all()


def test_responses_follow_the_shape(comm):
    case = rw.read_case(FIELDS, ["mesh.contact_elements=16"])
    contact = np.full(16, 80.0), 0.1, case.friction
    whole, worn = boundary_recovery(case, comm), np.zeros((2, 16))
    unworn = whole.fields(*contact, worn, worn)[0]
    worn[0] = 0.5
    moved = whole.fields(*contact, worn, worn)[0]
    again = whole.fields(*contact, 0.0 * worn, 0.0 * worn)[0]
    fixed = whole.fields(*contact, worn)[0]
    assert np.array_equal(unworn.displacement, again.displacement)
    assert np.abs(moved.displacement - unworn.displacement).max() > 1e-4
    # elements that stay: only what is shown has moved
    assert np.array_equal(fixed.nodes, moved.nodes)
    assert fixed.displacement == pytest.approx(unworn.displacement, abs=1e-12)


@pytest.mark.parametrize(
    ("overrides", "times"),
    [
        (["output.boundary=last"], [20]),
        (["output.boundary=[0, 7, 7.5, 19]", "output.every=6"], [0, 12, 20]),
        (["output.boundary=all", "output.every=8"], [0, 8, 16, 20]),
        (["time.end=20", "output.times=[5, 9]", "output.boundary=[4, 10]"], [5, 20]),
    ],
)
def test_which_states_are_stored(overrides, times, tmp_path, comm):
    path, adaptive = tmp_path / "run.h5", "time.end=20" in overrides
    words = SMALL[:1] if adaptive else SMALL[:2]
    run_case(FIELDS if adaptive else PAPER, path, [*words, *overrides], comm=comm)
    assert [state.time for state in rw.open_result(path).boundary] == times
