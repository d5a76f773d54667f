"""The search for the approach on contacts whose force is known in closed form."""

import numpy as np
import pytest

import ringwear_par as rw
from ringwear_par.contact.approach import find_approach

N = 20
AREA = np.full(N, 2.0)
GAP = 0.4 * np.linspace(-1.0, 1.0, N) ** 2
GAP -= GAP.min()


class _Springs:
    """Elements that do not know of each other, each stiffer the more it is pressed."""

    def __init__(self, power=1.0):
        self.power, self.approaches = power, []

    def contact_at(self, approach):
        self.approaches.append(approach)
        overlap = np.maximum(approach - GAP, 0.0)
        rate = 20.0 * self.power * overlap ** (self.power - 1.0) * (overlap > 0.0)
        self.force = float(AREA @ (20.0 * overlap**self.power))
        return self.force, float(AREA @ rate)


@pytest.mark.parametrize("power", [1.0, 1.5, 3.0])
@pytest.mark.parametrize("force", [1e-6, 1.0, 1e4])
def test_any_force_is_met_by_the_last_contact(power, force):
    springs, stiffness = _Springs(power), float(20.0 * AREA.sum())
    find_approach(force, float(GAP.mean()) + force / stiffness, stiffness, springs.contact_at)
    assert springs.force == pytest.approx(force, rel=1e-10)
    assert len(springs.approaches) < 40


def test_a_good_start_is_all_there_is_to_it():
    springs = _Springs()
    find_approach(500.0, float(GAP.mean()) + 500.0 / 800.0, 800.0, springs.contact_at)
    assert len(springs.approaches) == 1  # all elements touch: the stiffness is that


@pytest.mark.parametrize("derivative", [0.0, 40.0])
def test_a_force_that_no_approach_carries_is_an_error(derivative):
    def saturated(approach):
        return 40.0 * min(1.0, approach), derivative

    with pytest.raises(rw.ComputationError, match="force 40 N"):
        find_approach(100.0, 0.1, 40.0, saturated)


def test_a_force_that_is_no_number_is_an_error():
    with pytest.raises(rw.ComputationError, match="force nan N"):
        find_approach(100.0, 0.1, 40.0, lambda approach: (np.nan, 40.0))
