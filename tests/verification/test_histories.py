"""Wear histories against their steady states, similarity, and the largest explicit step."""

import math
from dataclasses import replace

import exact_solutions as exact
import numpy as np
import pytest
from parts import Load, Output, Ring, Stepping, ThresholdLaw
from reference_cases import NU, OMEGA, paper_case
from tracing import trace

import ringwear_par as rw
from ringwear_par.elasticity.mesh import Mesh

#: specific wear rates of both bodies, 1/MPa, where both wear
BOTH = (1e-7, 3e-7)


@pytest.mark.parametrize(
    ("p0", "k"), [((0.0, None), BOTH), ((40.0, None), BOTH), ((40.0, 60.0), BOTH)]
)
def test_steady_pressure_and_rate(p0, k):
    """p0 + c/r, and the rate of the approach is kappa omega c."""
    case = paper_case(Mesh(64), p0=p0, k=k, stepping=Stepping("implicit", 400.0, 20))
    history = trace(case, tao=True)
    wearing = [(ki, pi) for ki, pi in zip(k, p0, strict=True) if pi is not None]
    total = sum(ki for ki, _ in wearing)
    mean = sum(ki * pi for ki, pi in wearing) / total
    c = exact.steady_constant(case.load.force, mean, *case.contact)
    before, last = history.states[-2:]
    assert last.pressure == pytest.approx(mean + c / case.line.arm, rel=1e-3)
    rate = (last.approach - before.approach) / case.time.step
    assert rate == pytest.approx(case.friction * total * OMEGA * c, rel=1e-3)


def test_twice_the_wear_rate_in_half_the_time():
    slow, fast = (
        trace(paper_case(Mesh(64), p0=(0.0, 0.0), k=k, stepping=Stepping("adaptive", until=end)),
              tao=True).last
        for k, end in ((BOTH, 300.0), ((2e-7, 6e-7), 150.0))
    )  # fmt: skip
    assert fast.wear == pytest.approx(slow.wear, rel=1e-8)


def test_worn_solid_pin():
    """Steady p = F / (2 pi R r), torque mu F R / 2, rate mu k omega F / (2 pi R)."""
    radius, force, k, omega = 3.0, 3000.0, 1e-6, 1.0
    case = rw.Case(
        Ring((0.0, 10.0), (0.0, 10.0), 200e3, NU, "clamped"),
        Ring((0.0, radius), (10.0, 20.0), 200e3, NU, "clamped"),
        0.1, None, ThresholdLaw(k), Load(omega, force), Stepping("implicit", 2.5e4, 10), Mesh(64),
        Output(),
    )  # fmt: skip
    history, c = trace(case, tao=True), force / (2.0 * math.pi * radius)
    before, last = history.states[-2:]
    assert last.pressure * case.line.r == pytest.approx(np.full(64, c), rel=1e-7)
    torque = case.friction * history.torque_over_friction(last.pressure)
    assert torque == pytest.approx(0.5 * case.friction * force * radius, rel=1e-7)
    rate = (last.approach - before.approach) / case.time.step
    assert rate == pytest.approx(case.friction * k * omega * c, rel=1e-4)
    assert history.balances.energy < 1e-12


def test_largest_explicit_step():
    """On a uniform mesh under a rigid ring a step wears at most 1.485 h p / E*.

    The rings are wide (r = 300 mm), so that the sliding speed hardly varies along the contact.
    """
    n = 128
    case = paper_case(Mesh(n, grading=1.0), p0=(0.0, None), young=1e13)
    case = replace(case, lower=replace(case.lower, r=(290.0, 310.0)),
                   upper=replace(case.upper, r=(298.5, 301.5)))  # fmt: skip
    explicit = replace(case, time=Stepping("explicit", 1e-3, 1))
    step = trace(explicit).worst.measures["instability"][2, 0]
    wear = step * 1e-7 * case.friction * OMEGA * case.line.r.max()  # mm per MPa
    modulus = exact.contact_modulus((case.lower.young, NU))
    assert wear * modulus / (3.0 / n) == pytest.approx(exact.EXPLICIT_LIMIT, rel=2e-2)
