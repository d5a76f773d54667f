"""Many histories at once: each has the numbers that it has alone."""

import numpy as np
import pytest
from parts import Table

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
SIZES = (1.0, 2.0, 3.0, 4.0, 90.0)
LAWS = {
    "threshold": [ThresholdLaw(x * 1e-7, p0) for x, p0 in
                  zip(SIZES, (0.0, 9.0, 9.0, 40.0, 80.0), strict=True)],
    "schedules": [ThresholdLaw(k, p0) for k, p0 in zip(
        (IN_TIME, 1e-7, IN_TIME, 2e-7, 1e-7), (ALONG, 4.0, IN_TIME, ALONG, 0.0), strict=True)],
    "archard": [ArchardLaw(x * 1e-8) for x in SIZES],
    "power": [PowerLaw(1e-9, m, 0.7) for m in (1.0, 1.5, 2.0, 2.5, 3.0)],
    "table": [TableLaw(POINTS)] * 5,
    "running-in, depth": [RunningInLaw(1e-7, 5e-7, 20.0, depth=x * 1e-5) for x in SIZES],
    "running-in, distance": [RunningInLaw(1e-7, x * 1e-7, distance=x) for x in SIZES],
    "non-local": [NonLocalLaw(x * 1e-7, 40.0, length=0.4) for x in SIZES],
    "user": [UserLaw("law.py", USER, (("k", x * 1e-8), ("depth", 1e-4))) for x in SIZES],
}  # fmt: skip


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
    # quadrature of a rate alone takes long, and is the same for all laws with memory
    slow = () if isinstance(laws[0], UserLaw) else ("potential",)
    for i, single in enumerate(alone):
        for name in ("depth", "d_depth_dp", "jacobian", *slow):
            of_all, of_one = getattr(together, name)(p)[i], getattr(single, name)(p[i])
            np.testing.assert_allclose(of_all, of_one, rtol=1e-9, atol=0.0)


class Square:
    """Serves many histories at once."""

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


@pytest.mark.parametrize(("law", "serves"), [(Square(), True), (Elements(), False)])
def test_laws_that_are_wrong_for_many_histories_are_found_out(law, serves):
    assert serves_many(complete(law), R) == serves


@pytest.mark.parametrize(
    "laws",
    [
        (ThresholdLaw(1e-7), ArchardLaw(1e-7)),
        (NonLocalLaw(1e-7, length=0.1), NonLocalLaw(1e-7, length=0.2)),
        (TableLaw(POINTS), TableLaw(POINTS[:2])),
        (UserLaw("a.py", USER), UserLaw("a.py", USER + "\n")),
        (None, ArchardLaw(1e-7)),
    ],
)
def test_laws_that_cannot_be_stacked(laws):
    with pytest.raises(ValueError, match="cannot be stacked"):
        stack_laws(laws)
