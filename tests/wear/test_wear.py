"""Wear laws: values, derivatives by Taylor remainders, implicit steps with memory and averages."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from parts import Table, derivative
from taylor import taylor_order
from wearing import sliding, step_wear

from ringwear_par.wear.checked_law import complete
from ringwear_par.wear.increment import WearIncrement
from ringwear_par.wear.laws.archard import ArchardLaw
from ringwear_par.wear.laws.non_local import NonLocalLaw, averaging
from ringwear_par.wear.laws.power import PowerLaw
from ringwear_par.wear.laws.running_in import RunningInLaw
from ringwear_par.wear.laws.table import TableLaw
from ringwear_par.wear.laws.threshold import ThresholdLaw
from ringwear_par.wear.laws.user import UserLaw


@dataclass(frozen=True)
class Hardening:
    """A law as a user may write it: no base class, nothing but a rate."""

    k: float
    depth: float

    def rate(self, p, local):
        """Return the rate of wear, mm/s."""
        return self.k * np.exp(-local.wear / self.depth) * local.power * p


P = np.array([0.0, 10.0, 39.0, 41.0, 100.0])
POWER = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
USER = """
import numpy as np

def rate(p, at):
    k = at.parameters["k"] * (1.0 + np.exp(-at.wear / 0.01))
    return k * at.friction * at.speed * np.log1p(p / 50.0)

def d_rate_dp(p, at):
    k = at.parameters["k"] * (1.0 + np.exp(-at.wear / 0.01))
    return k * at.friction * at.speed / (50.0 + p)

def d_rate_dwear(p, at):
    k = -at.parameters["k"] * np.exp(-at.wear / 0.01) / 0.01
    return k * at.friction * at.speed * np.log1p(p / 50.0)
"""
LAWS = {
    "threshold": ThresholdLaw(1e-7, 40.0),
    "threshold, table in time": ThresholdLaw(Table((0.0, 9.0), (1e-7, 4e-7)), 40.0),
    "threshold, profile": ThresholdLaw(Table((28.0, 32.0), (1e-7, 4e-7), "r"), 40.0),
    "archard": ArchardLaw(1e-8),
    "power": PowerLaw(1e-9, 2.5, 0.7),
    "table": TableLaw(((0.0, 0.0), (50.0, 1e-6), (210.0, 8e-6), (400.0, 9e-6))),
    "running-in, depth": RunningInLaw(1e-7, 5e-7, 40.0, depth=2e-5),
    "running-in, distance": RunningInLaw(1e-7, 5e-7, 40.0, distance=3.0),
    "non-local": NonLocalLaw(1e-7, 40.0, length=0.8),
    "user": UserLaw("law.py", USER, (("k", 1e-7),)),
}


def test_steady_laws_know_neither_time_nor_wear():
    """What steps do not compute again; a law derived from one may know them."""
    here, later = (
        replace(sliding(POWER, time=time), wear=np.full(5, time * 1e-3), slid=np.full(5, time))
        for time in (0.5, 7.0)
    )
    steady = {name for name, law in LAWS.items() if law.is_steady}
    assert steady == {"threshold", "threshold, profile", "archard", "power", "table", "non-local"}
    for name in steady:
        assert np.array_equal(LAWS[name].rate(P, here), LAWS[name].rate(P, later)), name
    assert not type("Fading", (ArchardLaw,), {})(1e-8).is_steady


def test_lines_are_rates():
    at = sliding(POWER, time=3.0)
    lines = {name: line for name, law in LAWS.items() if (line := law.line(at)) is not None}
    assert {"threshold, table in time", "archard", "running-in, distance"} <= lines.keys()
    for name, (rise, onset) in lines.items():
        rate = LAWS[name].rate(P, at)
        assert rise * np.maximum(P - onset, 0.0) == pytest.approx(rate, rel=1e-14), name


def test_threshold_law_is_equation_4():
    rate = ThresholdLaw(1e-7, 40.0).rate(P, sliding(POWER))
    assert rate == pytest.approx([0, 0, 0, 4e-7, 3e-5])
    assert ThresholdLaw(1e-7).per_energy(0.1) == 1e-7
    assert ThresholdLaw(1e-7, 1.0).per_energy(0.1) is None
    assert ArchardLaw(1e-7).per_energy(0.1) == pytest.approx(1e-6)


def test_parameters_follow_time_and_radius():
    at = sliding(POWER, time=4.5)
    in_time = ThresholdLaw(Table((0.0, 9.0), (1e-7, 3e-7)), 40.0)
    assert in_time.rate(P, at) == pytest.approx(2 * ThresholdLaw(1e-7, 40.0).rate(P, at))
    along = ThresholdLaw(Table((28.5, 31.5), (0.0, 1e-7), "r"))
    assert along.rate(P, at) == pytest.approx(np.linspace(0, 1e-7, 5) * POWER * P)
    assert in_time.breakpoints == (9.0,)
    assert along.breakpoints == ()


def test_running_in_falls_with_distance_and_depth():
    law = RunningInLaw(1e-7, 5e-7, distance=3.0)
    at = sliding(POWER)
    assert law.rate(P, at) == pytest.approx(5e-7 * POWER * P)
    law = RunningInLaw(1e-7, 5e-7, depth=1e-3)
    worn = sliding(POWER, wear=np.full(5, 1e-3))
    assert law.rate(P, worn) == pytest.approx((1 + 4 / np.e) * 1e-7 * POWER * P)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize("step", [0.0, 3.0])
@pytest.mark.parametrize("worn", [0.0, 1e-5])
def test_taylor_remainders(law, step, worn):
    """Of the rate, and of the wear over an implicit step, memory included."""
    pressure = P + 5.0  # away from the kinks, where one-sided slopes are all there is
    at = sliding(POWER, time=2.0, wear=np.full(5, worn))
    direction = np.array([0.3, -0.2, 0.1, 0.2, -0.5])
    average = averaging(at.r, np.ones(5), law.length) if law.length else None
    wear = WearIncrement((law, None), (at, at), step or 1.0, (average, None))

    def f(h):
        p = pressure + h * direction
        return wear.depth(p) if step else law.rate(p, at)

    def slope(h):
        p = pressure + h * direction
        return wear.jacobian(p) @ direction if step else law.d_rate_dp(p, at) * direction

    assert taylor_order(f, slope, pressure.max()) > 1.9


PLAIN = """
import numpy as np

def rate(p, at):
    k = at.parameters["k"] * (1.0 + np.exp(-at.wear / 0.01))
    return k * at.friction * at.speed * np.log1p(p / 50.0)
"""
WITH_PLAIN = {
    **LAWS,
    "user, rate only": UserLaw("law.py", PLAIN, (("k", 1e-7),)),
    "a plain object": complete(Hardening(2e-8, 3e-5)),
}


@pytest.mark.parametrize("law", WITH_PLAIN.values(), ids=WITH_PLAIN)
@pytest.mark.parametrize("worn", [0.0, 1e-5])
def test_taylor_remainders_of_wear(law, worn):
    at, p = sliding(POWER, time=2.0, wear=np.full(5, worn)), P + 5.0

    def deeper(h):
        return replace(at, wear=at.wear + h)

    rates = lambda h: law.rate(p, deeper(h))  # noqa: E731
    assert taylor_order(rates, lambda h: law.d_rate_dwear(p, deeper(h)), 1e-5, 1e-14) > 1.9


def test_complex_steps_are_trusted_only_where_differences_agree():
    """Absolute values lose the imaginary part, interpolation refuses it."""
    x = np.array([0.5, 1.0, 2.0])
    for function in (np.exp, lambda x: np.exp(np.abs(x)), lambda x: np.exp(x.real)):
        assert derivative(function, x, 1e-3) == pytest.approx(np.exp(x), rel=1e-8)
    table = lambda x: np.interp(x, [0.0, 4.0], [0.0, 8.0])  # noqa: E731
    assert derivative(table, x, 1e-3) == pytest.approx(np.full(3, 2.0), rel=1e-8)
    assert derivative(lambda x: x**2, 0.0, 1e-3) == pytest.approx(0.0, abs=1e-12)


def test_a_law_needs_its_rate_only():
    """What a plain object lacks is found: derivatives, memory of worn depth, its integral."""
    own, at, step = Hardening(9e-7, 1e-6), sliding(POWER, wear=np.full(5, 1e-7)), 50.0
    increment = WearIncrement((complete(own), None), (at, at), step)
    depth = increment.depth(P)
    end = sliding(POWER, wear=1e-7 + depth)
    assert depth == pytest.approx(step * own.rate(P, end), rel=1e-12, abs=1e-30)
    known = RunningInLaw(0.0, 9e-7, depth=1e-6)
    exact = WearIncrement((known, None), (at, at), step)
    assert depth == pytest.approx(exact.depth(P), rel=1e-12, abs=1e-30)
    p = P + 5.0  # at no pressure the threshold counts as one that is not yet passed
    assert increment.d_depth_dp(p) == pytest.approx(exact.d_depth_dp(p), rel=1e-9)
    assert increment.potential(p) == pytest.approx(exact.potential(p), rel=1e-9)
    assert complete(own).breakpoints == ()
    assert complete(known) is known


def test_a_plain_law_may_know_more():
    class Archard:
        remembers = False
        breakpoints = (3.0, 1)
        length = 0.5

        def rate(self, p, local):
            return 1e-8 * p * local.speed

        def d_rate_dp(self, p, local):
            return 1e-8 * local.speed

        def per_energy(self, friction):
            return 1e-8 / friction

    law, at = complete(Archard()), sliding(POWER)
    assert (law.length, law.remembers, law.breakpoints) == (0.5, False, (1.0, 3.0))
    assert law.per_energy(0.1) == ArchardLaw(1e-8).per_energy(0.1)
    assert (law.d_rate_dp(P, at) == ArchardLaw(1e-8).d_rate_dp(P, at)).all()
    assert not law.d_rate_dwear(P, at).any()


def test_files_remember_wear_by_reading_it():
    assert UserLaw("a.py", PLAIN).remembers
    assert not UserLaw("a.py", PLAIN + "remembers = False\n").remembers
    assert not UserLaw("a.py", "def rate(p, at): return p * at.speed").remembers
    at = sliding(POWER, wear=np.full(5, 1e-3))
    law, plain = (UserLaw("a.py", text, (("k", 1e-7),)) for text in (USER, PLAIN))
    for name in ("d_rate_dp", "d_rate_dwear"):
        exact = getattr(law, name)(P, at)
        assert getattr(plain, name)(P, at) == pytest.approx(exact, rel=1e-9)
    assert UserLaw("a.py", PLAIN + "breakpoints = [2, 1]").breakpoints == (1.0, 2.0)


def test_a_wrong_derivative_is_found():
    law = UserLaw("law.py", USER.replace("/ (50.0 + p)", "/ (51.0 + p)"), (("k", 1e-7),))
    at, p = sliding(POWER), P + 5.0
    order = taylor_order(lambda h: law.rate(p + h, at), lambda h: law.d_rate_dp(p + h, at), 1e2)
    assert order < 1.1


@pytest.mark.parametrize("worn", [0.0, 1e-5])
def test_depths_of_implicit_steps_in_closed_form(worn):
    """The depth is step rate(p, wear + depth)."""
    at, p = sliding(POWER, wear=np.full(5, worn)), P + 5.0
    depths = [(law, law.depth_in_step(p, at, 3.0)) for law in LAWS.values() if law.remembers]
    closed = [(law, depth) for law, depth in depths if depth is not None]
    assert closed
    for law, depth in closed:
        assert depth == pytest.approx(3.0 * law.rate(p, at.worn_by(depth)), rel=1e-12)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_the_potential_is_the_integral_of_the_depth(law):
    """By central differences of area sums, which all laws' potentials share."""
    pressure, direction = P + 5.0, np.array([0.3, -0.2, 0.1, 0.2, -0.5])
    at = sliding(POWER, time=2.0)
    area = np.array([1.0, 1.5, 2.0, 1.2, 0.7])
    average = averaging(at.r, area, law.length) if law.length else None
    step = WearIncrement((law, ThresholdLaw(5e-7, 70.0)), (at, at), 3.0, (average, None))
    h = 1e-3
    up, down = (area @ step.potential(pressure + s * h * direction) for s in (1, -1))
    exact = area @ (step.depth(pressure) * direction)
    assert (up - down) / (2 * h) == pytest.approx(exact, rel=1e-6)


def test_averages_keep_constants_and_volumes():
    r = np.linspace(28.5, 31.5, 40) ** 2 / 30.0
    area = 2 * np.pi * r * np.gradient(r)
    average = averaging(r, area, 0.4)
    assert average.sum(axis=1) == pytest.approx(np.ones(40), abs=1e-13)
    assert area @ average == pytest.approx(area, rel=1e-12)
    assert np.linalg.eigvalsh(area[:, None] * average).min() > -1e-12 * area.max()
    assert averaging(r, area, 1e-6) == pytest.approx(np.eye(40), abs=1e-12)


def test_non_local_becomes_local():
    at = sliding(POWER)
    local, other = ThresholdLaw(1e-7, 40.0), NonLocalLaw(1e-7, 40.0, length=1e-4)
    average = averaging(at.r, np.ones(5), other.length)
    step = WearIncrement((other, None), (at, at), 2.0, (average, None))
    assert step.depth(P) == pytest.approx(step_wear((local,), POWER, 2.0).depth(P))


def test_bodies_that_share_a_law_remember_their_own_wear():
    law = RunningInLaw(k=1e-7, k_start=1e-6, depth=0.01)
    at = tuple(sliding(POWER, wear=np.full_like(P, depth)) for depth in (0.0, 0.05))
    both = WearIncrement((law, law), at, 5.0).depths(P)
    for depth, body in zip(both, at, strict=True):
        assert depth == pytest.approx(WearIncrement((law, None), (body, body), 5.0).depths(P)[0])
    assert (both[1][1:] < both[0][1:]).all()
