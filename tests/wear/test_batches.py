"""Many histories at once: each has the numbers that it has alone."""

from dataclasses import dataclass

import numpy as np
import pytest
from parts import Stacked, Table

import ringwear_par as rw
from ringwear_par import schedules
from ringwear_par.wear import LocalState
from ringwear_par.wear.checked_law import complete
from ringwear_par.wear.increment import WearIncrement
from ringwear_par.wear.law import stack_laws
from ringwear_par.wear.laws.archard import ArchardLaw
from ringwear_par.wear.laws.non_local import NonLocalLaw, averaging
from ringwear_par.wear.laws.power import PowerLaw
from ringwear_par.wear.laws.running_in import RunningInLaw
from ringwear_par.wear.laws.table import TableLaw
from ringwear_par.wear.laws.threshold import ThresholdLaw
from ringwear_par.wear.laws.user import UserLaw
from ringwear_par.wear.trials import serves_many

N = 37
R = np.linspace(28.5, 31.5, N)
AREA = 2 * np.pi * R * np.gradient(R)
IN_TIME = Table((0.0, 1.3, 9.0), (1e-7, 3e-7, 2e-7))
ALONG = Table((28.0, 30.1, 32.0), (10.0, 40.0, 20.0), "r")
POINTS = ((0.0, 0.0), (50.0, 1e-6), (210.0, 8e-6), (400.0, 9e-6))
USER = """
import numpy as np
def rate(p, at):
    if at.time > 3.0:
        return 1e-8 * at.speed * p
    k = at.parameters["k"] * (1.0 + np.exp(-at.wear / at.parameters["depth"]))
    return k * at.friction * at.speed * p
"""
FIVE = (1.0, 2.0, 3.0, 4.0, 90.0)


def laws_of(make, *parameters):
    """Return the laws of five histories."""
    return [make(*each) for each in zip(*parameters, strict=True)]


LAWS = {
    "threshold": laws_of(ThresholdLaw, (1e-7, 2e-7, 1e-7, 3e-7, 7e-7), (0.0, 9.0, 9.0, 40.0, 80.0)),
    "schedules": laws_of(
        ThresholdLaw, (IN_TIME, 1e-7, IN_TIME, 2e-7, 1e-7), (ALONG, 4.0, IN_TIME, ALONG, 0.0)
    ),
    "archard": [ArchardLaw(x * 1e-8) for x in FIVE],
    "power": laws_of(PowerLaw, (1e-9,) * 5, (1.0, 1.5, 2.0, 2.5, 3.0), (0.5, 1.0, 1.0, 2.0, 0.7)),
    "table": [TableLaw(POINTS)] * 5,
    "running-in, depth": [RunningInLaw(1e-7, 5e-7, 20.0, depth=x * 1e-5) for x in FIVE],
    "running-in, distance": [RunningInLaw(1e-7, x * 1e-7, distance=x) for x in FIVE],
    "non-local": [NonLocalLaw(x * 1e-7, 40.0, length=0.4) for x in FIVE],
    "user": [UserLaw("law.py", USER, (("k", x * 1e-8), ("depth", 1e-4))) for x in FIVE],
}


def increments(laws):
    """Return the increment of all histories, those of each alone, and pressures (5, n)."""
    rng = np.random.default_rng(3)
    times, steps = np.array([0.0, 0.7, 1.3, 4.2, 20.0]), np.array([0.3, 0.7, 1.1, 2.0, 5.0])
    friction, omega = rng.uniform(0.05, 0.3, 5), rng.uniform(1.0, 5.0, 5)
    wear, p = rng.uniform(0.0, 1e-4, (5, N)), np.maximum(rng.uniform(-30.0, 200.0, (5, N)), 0.0)
    upper = ThresholdLaw(5e-8, 70.0)
    average = averaging(R, AREA, laws[0].length) if laws[0].length else None
    alone = []
    for i, law in enumerate(laws):
        time, mu, w = float(times[i]), float(friction[i]), float(omega[i])
        at = LocalState(time, R, w * R, mu, wear[i], w * R * time)
        alone.append(WearIncrement((law, upper), (at, at), float(steps[i]), (average, None)))
    speed = omega[:, None] * R
    at = LocalState(times, R, speed, friction, wear, speed * times[:, None])
    return WearIncrement((stack_laws(laws), upper), (at, at), steps, (average, None)), alone, p


@pytest.mark.parametrize("laws", LAWS.values(), ids=LAWS)
def test_stacked_laws_have_the_numbers_of_each(laws):
    together, alone, p = increments(laws)
    law, at = stack_laws(laws), together.at[0]
    # quadrature of a rate alone takes long, and is the same for all laws with memory
    slow = () if isinstance(laws[0], UserLaw) else ("potential",)
    for i, single in enumerate(alone):
        for name in ("depth", "d_depth_dp", "jacobian", *slow):
            of_all, of_one = getattr(together, name)(p)[i], getattr(single, name)(p[i])
            np.testing.assert_allclose(of_all, of_one, rtol=1e-9, atol=0.0)
        for name in law.numeric:
            of_all = law.d_rate_dparameter(name, p, at)[i]
            of_one = laws[i].d_rate_dparameter(name, p[i], single.at[0])
            np.testing.assert_allclose(of_all, of_one, rtol=1e-9, atol=0.0)


@dataclass(frozen=True)
class Square:
    """Its complex values have negative real parts where there is no pressure."""

    def rate(self, p, local):
        """Return the rate."""
        return 1e-10 * local.speed * p**2


class Elements:
    """Code for one history: it takes the first rows for elements."""

    def rate(self, p, local):
        """Return the rate."""
        rate = 1e-8 * local.speed * p
        rate[:4] = 0.0
        return rate


class Largest:
    """It looks at all pressures at once."""

    def rate(self, p, local):
        """Return the rate."""
        return 1e-8 * local.speed * p * p / max(p.max(), 1.0)


@pytest.mark.parametrize(
    ("law", "serves"),
    [
        (Square(), True),
        (ThresholdLaw(IN_TIME, ALONG), True),
        (Elements(), False),
        (Largest(), False),
    ],
    ids=lambda law: type(law).__name__,
)
def test_who_does_not_serve_many_histories_is_found_out(law, serves):
    assert serves_many(complete(law), R) == serves


@pytest.mark.parametrize(
    "laws",
    [
        (ThresholdLaw(1e-7), ArchardLaw(1e-7)),
        (NonLocalLaw(1e-7, length=0.1), NonLocalLaw(1e-7, length=0.2)),
        (RunningInLaw(1.0, 2.0, depth=1.0), RunningInLaw(1.0, 2.0, distance=1.0)),
        (TableLaw(POINTS), TableLaw(POINTS[:2])),
        (UserLaw("a.py", USER), UserLaw("a.py", USER + "\n")),
        (UserLaw("a.py", USER, (("k", 1.0),)), UserLaw("a.py", USER, (("j", 1.0),))),
    ],
)
def test_laws_that_cannot_be_stacked(laws):
    with pytest.raises(ValueError, match="cannot be stacked"):
        stack_laws(laws)
    assert stack_laws([laws[0]] * 3) is laws[0]
    assert stack_laws([None, None]) is None
    with pytest.raises(ValueError, match="cannot be stacked"):
        stack_laws([None, laws[0]])


def test_a_history_that_does_not_settle_is_named():
    growing = "def rate(p, at): return at.parameters['k'] * p * (1 + at.wear / 1e-3)\n"
    laws = [UserLaw("a.py", growing, (("k", k),)) for k in (1e-9, 1e-9, 1e-3, 1e-9, 1e-9)]
    together, _, p = increments(laws)
    with pytest.raises(rw.ComputationError, match=r"history 2, .* does not settle"):
        together.depth(p)


def test_schedules_at_many_times():
    ramp = Table((0.5, 3.0, 9.0), (1.0, 2.0, -1.0))
    starts = np.random.default_rng(1).uniform(-1.0, 10.0, 50)
    ends = starts + 1.3
    mixed = Stacked(tuple(ramp if i % 2 else 0.1 * i for i in range(50)))
    own = [schedules.history(mixed, i) for i in range(50)]
    for function, times in (
        (schedules.in_time, (ends,)),
        (schedules.integral, (starts, ends)),
        (schedules.mean, (starts, ends)),
    ):
        each = [function(q, *map(float, t)) for q, *t in zip(own, *times, strict=True)]
        np.testing.assert_allclose(function(mixed, *times), each, rtol=1e-12, atol=1e-15)
    assert schedules.breakpoints(mixed) == ramp.x
    assert (schedules.largest(mixed), schedules.smallest(mixed)) == (0.1 * 48, -1.0)
