"""Wear of sloping faces: true areas, laws along the normal, faces that turn, doubts."""

import math
from dataclasses import replace

import numpy as np
import pytest
from parts import (
    Mesh,
    NonLocalLaw,
    Output,
    RunningInLaw,
    Stepping,
    ThresholdLaw,
    UpdatedGeometry,
    case_slopes,
    common_slope,
    compliance,
    node_wear,
)
from paths import CASES, PAPER
from reference_cases import CONTACT, Rings, ring_case
from tracing import ALONE, trace

import ringwear_par as rw
from ringwear_par.history.block import Block
from ringwear_par.history.elastic import assemble, bodies

CHAMFER = CASES / "chamfer.toml"
DEGREES = 10.0
COS = math.cos(math.radians(DEGREES))
K = (1e-7, 3e-7)


@pytest.fixture(scope="module")
def cones():
    """Matched cones, both of which wear, and their pair."""
    case = ring_case(Rings(CONTACT, (1e4, 1e5), DEGREES), Mesh(24),
                     Stepping("implicit", 2.0, 5), K)  # fmt: skip
    return replace(case, output=Output()), assemble(case, ALONE)


def test_torque_and_energy_are_those_of_the_true_area(cones):
    case, pair = cones
    history = trace(case, pair, tao=True)
    (unworn, state, *_), line = history.states, history.line
    p = unworn.pressure
    flat = float((line.area * line.r) @ p)
    assert history.torque_over_friction(p) == pytest.approx(flat / COS, rel=1e-12)
    assert unworn.force == pytest.approx(case.load.force, rel=1e-12)
    power = case.load.omega * case.friction * float((line.area * line.r) @ state.pressure) / COS
    assert state.energy == pytest.approx(2.0 * power, rel=1e-12)
    # depths along the axis; along the normal they are k p s
    distance = case.load.omega * line.r * 2.0
    for k, worn in zip(K, state.wear, strict=True):
        exact = k * case.friction * state.pressure * distance
        assert worn * COS == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("scheme", ["explicit", "implicit", "adaptive"])
def test_worn_volumes_are_k_times_the_energy(cones, scheme):
    case, pair = cones
    time = Stepping("adaptive", until=50.0) if scheme == "adaptive" else Stepping(scheme, 0.1, 5)
    history = trace(replace(case, time=time), pair)
    last, line = history.last, history.line
    for k, worn in zip(K, last.wear, strict=True):
        assert line.area @ worn == pytest.approx(k * last.energy, rel=1e-11)
    assert history.balances.energy < 1e-11
    assert last.wear.min() >= 0.0


LAWS = {
    "non-local": (NonLocalLaw(1e-7, 20.0, length=0.3), NonLocalLaw(3e-8, 0.0, length=0.1)),
    "running-in, depth": (RunningInLaw(1e-7, 9e-7, 20.0, depth=2e-4), ThresholdLaw(1e-8)),
    "running-in, distance": (RunningInLaw(1e-7, 9e-7, distance=200.0), None),
}


@pytest.mark.parametrize("laws", LAWS.values(), ids=LAWS)
def test_other_laws_on_cones(cones, laws):
    """Contacts hold, depths are those of the rates, and both schemes come to the same."""
    base, pair = cones
    case = replace(base, wear_lower=laws[0], wear_upper=laws[1], time=Stepping("implicit", 0.1, 20))
    history = trace(case, pair, tao=True)
    assert history.balances.force < 1e-10
    assert history.balances.residual < 1e-7
    before, last = history.states[-2:]
    assert (last.wear - before.wear) / 0.1 == pytest.approx(last.rates, rel=1e-5, abs=1e-12)
    adaptive = trace(replace(case, time=Stepping("adaptive", until=2.0, tolerance=1e-6)), pair)
    assert last.wear == pytest.approx(adaptive.last.wear, rel=0.1, abs=1e-8)
    assert last.wear[0].max() > 1e-5


def test_running_in_remembers_depths_along_the_normal(cones):
    """At the end of the second step, the wear of both is what the law is told of."""
    base, pair = cones
    law = RunningInLaw(1e-7, 9e-7, 0.0, depth=2e-4)
    case = replace(base, wear_lower=law, wear_upper=None, time=Stepping("implicit", 3.0, 2))
    _, first, second = trace(case, pair, tao=True).states
    depth, p = second.wear[0] * COS, second.pressure
    k = 1e-7 + 8e-7 * np.exp(-depth / 2e-4)
    rate = k * case.friction * case.load.omega * pair.line.r * p
    assert (second.wear[0] - first.wear[0]) * COS == pytest.approx(3.0 * rate, rel=1e-8)
    assert depth.max() > 0.3 * 2e-4


@pytest.mark.parametrize("laws", LAWS.values(), ids=LAWS)
def test_slopes_of_a_step_are_derivatives_of_its_depths(cones, laws):
    """On faces whose slope differs from element to element."""
    base, pair = cones
    case = replace(base, wear_lower=laws[0], wear_upper=laws[1])
    block, x = Block.of([case], [pair]), np.linspace(0.0, 1.0, 24)
    obliquity = np.hypot(1.0, np.sin(4.0 * x))
    assert np.ptp(obliquity) > 0.25
    block = replace(block, line=replace(block.line, obliquity=obliquity))
    wear = np.full((len(block.wearing), 1, 24), 1e-5)
    three, zero = np.full(1, 3.0), np.zeros(1)
    step = block.step_wear(wear.astype(int), zero, block.sliding(zero), wear, three)
    p, direction = 50.0 + 20.0 * np.cos(9.0 * x), 4.0 * np.cos(23.0 * x)
    depth, slope = step.of_one(p)
    ends = [step.of_one(p + h * direction)[0] for h in (1e-3, -1e-3)]
    along = slope @ direction if slope.ndim == 2 else slope * direction
    found = (ends[0] - ends[1]) / 2e-3
    assert found == pytest.approx(along, rel=1e-5, abs=1e-7 * np.abs(along).max())
    assert step.depths(p[None]).sum(axis=0)[0] == pytest.approx(depth, rel=1e-12)


@pytest.fixture(scope="module")
def cutting():
    """A chamfered hard ring that has cut some tens of um into a soft flat one."""
    keys = {
        "mesh.contact_elements": 32, "mesh.geometry": "updated",
        "mesh.geometry_tolerance": 0.005, "upper.chamfer": 0.2, "upper.young": 210e3,
        "wear.lower": {"law": "archard", "k": 2e-8}, "time": {"scheme": "adaptive", "end": 400.0},
    }  # fmt: skip
    return trace(rw.read_case(CHAMFER, keys))


def test_pressure_on_a_conforming_chamfer_is_that_beside_it_times_the_cosine(cutting):
    """All of the face goes down at one rate along the axis: k p V / cos alpha."""
    last, slope = cutting.last, cutting.line.pairs[0].slope
    p, line = last.pressure, cutting.line
    assert 0.05 < last.wear[0].max() < 0.1
    assert not last.wear[1].any()
    for side, sign in ((line.r < 30.0, -1.0), (line.r > 30.0, 1.0)):
        conforming = side & (sign * slope > 0.95)
        beside = side & (slope == 0.0) & (np.abs(line.r - 30.0) < 1.3) & (p > 0.0)
        beside &= np.abs(line.r - 30.0) > 1.2
        assert conforming.any()
        assert beside.any()
        share = p[conforming] / p[beside].mean()
        assert share == pytest.approx(1.0 / math.sqrt(2.0), rel=0.05)
        rates = last.rates[0][side & (p > 0.0)]
        assert np.ptp(rates) < 0.05 * rates.mean()
    # no jumps where slopes turn: the singular edges' pressures fall
    largest = np.array([state.pressure.max() for state in cutting.states])
    assert (largest[1:] < 1.1 * largest[:-1]).all()
    assert cutting.balances.energy < 1e-12
    assert cutting.balances.torque < 1e-3


def test_a_body_that_does_not_wear_is_solved_again_when_the_slope_turns(cutting, comm):
    """And not otherwise; what it gives way is that of a fresh assembly with that slope."""
    case = cutting.block.cases.every[0]
    moving, n = UpdatedGeometry(bodies(case), case.line, case.mesh, comm), case.line.n
    pairs = [moving.update(np.zeros((2, n)))]
    assert not pairs[0].slope.any()
    worn = cutting.last.meshed
    pairs.append(moving.update(worn))
    assert np.abs(pairs[1].slope).max() > 0.9
    assert np.abs(pairs[1].normal[1] - pairs[0].normal[1]).max() > 1e-3 * pairs[0].normal[1].max()
    slope = common_slope(case_slopes(case.sections, case.line, case.mesh, worn))
    assert np.array_equal(pairs[1].slope, slope)
    both = zip(bodies(case), worn, (slope, -slope), strict=True)
    for i, (body, depth, own) in enumerate(both):
        fresh = compliance(body, case.line, case.mesh, comm, node_wear(case.line, depth), own)
        for name, exact in (
            ("normal", fresh.normal), ("twist", case.line.area @ fresh.torsion),
            ("force_reaction", fresh.force_reaction), ("torque_reaction", fresh.torque_reaction),
        ):  # fmt: skip
            found = getattr(pairs[1], name)[i]
            assert np.abs(found - exact).max() <= 1e-12 * np.abs(exact).max(), name


def flags(case, comm):
    """Doubts about a history, by their codes."""
    return {doubt.code: doubt.text for doubt in rw.simulate(case, comm).doubts}


def test_a_steep_cone_that_bears_on_a_flat_face_is_doubted_with_its_place(comm):
    steep = {
        "mesh.contact_elements": 24, "time.steps": 2,
        "upper.profile": [[28.5, 20.9], [30.0, 20.0], [31.5, 20.9]], "load.pressure": 20.0,
        "lower.young": 1e3, "upper.young": 2e5,
    }  # fmt: skip
    case = rw.read_case(PAPER, steep)
    text = flags(case, comm)["unlike_slopes"]
    r = float(text.split("r = ")[1].split()[0])
    assert np.abs(case.line.r - r).min() < 1e-4
    assert abs(r - 30.0) < 0.5
    angle = float(text.split("upper by ")[1].split()[0])
    assert abs(angle) == pytest.approx(math.degrees(math.atan(0.9 / 1.5)), rel=1e-2)
    assert 5.0 < float(text.split()[0]) <= 100.0
    gentle = case.replace({"upper.profile": [[28.5, 20.1], [30.0, 20.0], [31.5, 20.1]]})
    assert "unlike_slopes" not in flags(gentle, comm)


def test_faces_that_have_worn_to_each_other_are_doubted_only_if_the_elements_have_not(comm):
    """Over a chamfer of 45 degrees, once it bears load: what "updated" is advised for."""
    keys = {
        "mesh.contact_elements": 24, "upper.chamfer": 0.2, "upper.young": 210e3,
        "wear.lower": {"law": "archard", "k": 2e-8}, "time": {"scheme": "adaptive", "end": 300.0},
    }  # fmt: skip
    case = rw.read_case(CHAMFER, keys)
    assert "on a slope of 0 degrees" in flags(case, comm)["unlike_slopes"]
    following = case.replace({"mesh.geometry": "updated"})
    assert "updated" not in flags(following, comm).get("unlike_slopes", "")
