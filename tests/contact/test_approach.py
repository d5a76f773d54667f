"""The search for the approach on contacts whose force is known in closed form."""

import numpy as np
import pytest

from ringwear_par.contact.approach import ApproachSearch, Trial
from ringwear_par.errors import ComputationError

N = 20
AREA = np.full(N, 2.0)
COMPLIANCE = np.diag(np.full(N, 0.1))


class _Springs:
    """Elements that do not know of each other, each stiffer the more it is pressed."""

    def __init__(self, power=1.0):
        self.power, self.solved = power, 0

    def solve_at(self, gap, approach):
        self.solved += 1
        self.overlap = np.maximum(approach - gap, 0.0)
        p = 20.0 * self.overlap**self.power
        return Trial(p, float(AREA @ p), 1, 0.0)

    def tangent(self):
        return 20.0 * self.power * self.overlap ** (self.power - 1.0) * (self.overlap > 0.0)


@pytest.mark.parametrize("power", [1.0, 1.5, 3.0])
@pytest.mark.parametrize("known", [True, False], ids=["tangent", "secant"])
@pytest.mark.parametrize("force", [1e-6, 1.0, 1e4])
def test_any_force_is_found(power, known, force):
    gap = 3.0 + 0.4 * np.linspace(-1.0, 1.0, N) ** 2
    springs, search = _Springs(power), ApproachSearch(COMPLIANCE, AREA)
    approach, trial = search.find(
        gap, force, springs.solve_at, springs.tangent if known else lambda: None
    )
    assert trial.force == pytest.approx(force, rel=1e-10)
    assert trial.force == float(AREA @ trial.pressure)
    assert trial.iterations == springs.solved
    # round-off of the approach itself: gaps are of the order of 1 mm
    p = 20.0 * np.maximum(approach - gap, 0.0) ** power
    assert p == pytest.approx(trial.pressure, abs=1e-9 * 20.0 * power * (1.0 + p.max()))


def test_a_second_search_starts_where_the_first_ended():
    gap = 3.0 * np.linspace(-1.0, 1.0, N) ** 2
    springs, search = _Springs(), ApproachSearch(COMPLIANCE, AREA)
    first, _ = search.find(gap, 500.0, springs.solve_at, springs.tangent)
    cold = springs.solved
    again, trial = search.find(gap + 0.3, 500.0, springs.solve_at, springs.tangent)
    assert trial.iterations == 1 < cold  # all wears alike: predicted exactly
    assert again == pytest.approx(first + 0.3, rel=1e-12)
    search.restart()
    assert search.last is None
    assert search.find(gap, 500.0, springs.solve_at, springs.tangent)[0] == first
    assert springs.solved == 2 * cold + 1


def test_a_force_that_no_approach_carries_is_an_error():
    def saturated(gap, approach):
        p = np.full(N, min(1.0, approach))
        return Trial(p, float(AREA @ p), 1, 0.0)

    with pytest.raises(ComputationError, match="the approach was not found: force 40 N instead of"):
        ApproachSearch(COMPLIANCE, AREA).find(np.zeros(N), 100.0, saturated, lambda: None)
