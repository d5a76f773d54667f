"""Laws of a case: the key that names one, what laws declare, what is tried before a run."""

from dataclasses import dataclass, replace

import pytest
from parts import RunningInLaw
from paths import PAPER

import ringwear_par as rw
from ringwear_par.cases.files.reading import read_case


def test_a_case_takes_a_law_with_a_rate_alone():
    @dataclass(frozen=True)
    class Mine:
        k: float

        def rate(self, p, local):
            return self.k * local.speed * p

    case = replace(read_case(PAPER), wear_lower=Mine(1e-8))
    lower, upper = case.laws
    assert (lower.code.source, upper) == (Mine(1e-8), None)
    assert lower.describe() == "Mine.rate(p, local) with k = 1e-08"
    assert case.breakpoints == ()


def test_numbers_of_running_in_from_python_are_refused_as_those_of_files():
    RunningInLaw(k=2e-7, k_start=2e-7, depth=1.0)
    with pytest.raises(rw.InputError, match="k_start = 1e-07"):
        RunningInLaw(k=2e-7, k_start=1e-7, depth=1.0)
