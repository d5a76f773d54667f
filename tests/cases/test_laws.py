"""Laws of a case: the key that names one, what laws declare, what is tried before a run."""

from dataclasses import dataclass, replace

from paths import PAPER

from ringwear_par.cases.files.reading import read_case


def test_a_case_takes_a_law_with_a_rate_alone():
    @dataclass(frozen=True)
    class Mine:
        k: float

        def rate(self, p, local):
            return self.k * local.speed * p

    case = replace(read_case(PAPER), wear_lower=Mine(1e-8))
    (lower,), upper = case.laws
    assert (lower.code.source, upper) == (Mine(1e-8), ())
    assert lower.describe() == "Mine.rate(p, local) with k = 1e-08"
    assert case.breakpoints == ()
