"""Wear histories against their steady states, similarity, and the largest explicit step."""

import math
from dataclasses import replace

import exact_solutions as exact
import numpy as np
import pytest
from reference_cases import NU, OMEGA, paper_case

from ringwear_par.cases.case import Case, Load, Output, Ring, Stepping
from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.observers.trace import trace
from ringwear_par.history.physics import Physics
from ringwear_par.history.refusals.stable_steps import stable_steps
from ringwear_par.wear.laws.threshold import ThresholdLaw

#: specific wear rates of both bodies, 1/MPa, where both wear
BOTH = (1e-7, 3e-7)


@pytest.mark.parametrize(
    ("p0", "k"), [((0.0, None), BOTH), ((40.0, None), BOTH), ((40.0, 60.0), BOTH)]
)
def test_steady_pressure_and_rate(p0, k, comm):
    """p0 + c/r, and the rate of the approach is kappa omega c."""
    case = paper_case(Mesh(64), p0=p0, k=k, stepping=Stepping("implicit", 400.0, 20))
    history = trace(case, comm)
    wearing = [(ki, pi) for ki, pi in zip(k, p0, strict=True) if pi is not None]
    total = sum(ki for ki, _ in wearing)
    mean = sum(ki * pi for ki, pi in wearing) / total
    c = exact.steady_constant(case.load.force, mean, *case.contact)
    before, last = (state.contact for state in history.states[-2:])
    assert last.pressure == pytest.approx(mean + c / case.line.arm, rel=1e-3)
    rate = (last.approach - before.approach) / case.time.step
    assert rate == pytest.approx(case.friction * total * OMEGA * c, rel=1e-3)


def test_twice_the_wear_rate_in_half_the_time(comm):
    slow, fast = (
        trace(paper_case(Mesh(64), p0=(0.0, 0.0), k=k, stepping=Stepping("adaptive", until=end)),
              comm).last
        for k, end in ((BOTH, 300.0), ((2e-7, 6e-7), 150.0))
    )  # fmt: skip
    assert fast.wear == pytest.approx(slow.wear, rel=1e-8)


def test_worn_solid_pin(comm):
    """Steady p = F / (2 pi R r), torque mu F R / 2, rate mu k omega F / (2 pi R)."""
    radius, force, k, omega = 3.0, 3000.0, 1e-6, 1.0
    case = Case(
        Ring((0.0, 10.0), (0.0, 10.0), 200e3, NU, "clamped"),
        Ring((0.0, radius), (10.0, 20.0), 200e3, NU, "clamped"),
        0.1, None, ThresholdLaw(k), Load(omega, force), Stepping("implicit", 2.5e4, 10), Mesh(64),
        Output(),
    )  # fmt: skip
    history, c = trace(case, comm), force / (2.0 * math.pi * radius)
    before, last = (state.contact for state in history.states[-2:])
    assert last.pressure * case.line.r == pytest.approx(np.full(64, c), rel=1e-7)
    torque = history.physics.torque(last.pressure)[0]
    assert torque == pytest.approx(0.5 * case.friction * force * radius, rel=1e-7)
    rate = (last.approach - before.approach) / case.time.step
    assert rate == pytest.approx(case.friction * k * omega * c, rel=1e-4)
    assert history.balances.energy < 1e-12


def test_largest_explicit_step(comm):
    """On a uniform mesh under a rigid ring a step wears at most 1.485 h p / E*.

    The rings are wide (r = 300 mm), so that the sliding speed hardly varies along the contact.
    """
    n = 128
    case = paper_case(Mesh(n, grading=1.0), p0=(0.0, None), young=1e13)
    case = replace(case, lower=replace(case.lower, r=(290.0, 310.0)),
                   upper=replace(case.upper, r=(298.5, 301.5)))  # fmt: skip
    physics = Physics.of([case], assemble(case, comm))
    with physics.contacts() as contacts:
        (step,) = stable_steps(physics, contacts)
    wear = step * 1e-7 * case.friction * OMEGA * physics.line.arm.max()  # mm per MPa
    modulus = exact.contact_modulus((case.lower.young, NU))
    assert wear * modulus / (3.0 / n) == pytest.approx(exact.EXPLICIT_LIMIT, rel=2e-2)
