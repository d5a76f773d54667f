"""Repeats: tests of the same conditions, and how much their specific wear rates scatter."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student

from ringwear_par.cases.units import SPECIFIC
from ringwear_par.measuring.analysis.budget import COVERAGE
from ringwear_par.measuring.analysis.numbers import TestNumbers
from ringwear_par.measuring.definition.problem import Conditions

#: relative difference below which loads and speeds are the same
_SAME = 0.02
#: sd by which two tests differ in one of twenty pairs (ISO 5725), and the quantile that this is
_REPEATABILITY, _LEVEL = 2.8, 0.975


@dataclass(frozen=True)
class Repeats:
    """Steady tests of the same conditions."""

    #: their names
    tests: tuple[str, ...]
    #: mm3/(N m), of logarithms
    mean: float
    #: of the mean, 95 %: Student's t of the scatter, which has the errors of each test's own in it
    #: (readings, steadiness), and in squares what all tests share, as they have one rig
    interval: tuple[float, float]
    #: standard deviation of the logarithms
    s_r: float

    @property
    def r(self) -> float:
        """Repeatability limit, a share: two tests differ by more in one of twenty pairs."""
        return _REPEATABILITY * self.s_r

    def to_dict(self) -> dict[str, Any]:
        """Return its entry in measure.json."""
        return {
            "tests": list(self.tests),
            "specific_wear_rate": {
                "mean": self.mean, "interval": list(self.interval), "s_r": self.s_r, "r": self.r,
                "unit": SPECIFIC,
            },
        }  # fmt: skip


def repeats_of(tests: Iterable[TestNumbers]) -> tuple[Repeats, ...]:
    """Return the groups of two steady tests or more whose loads and speeds are within 2 %.

    Of tests with the same record the first counts.
    """
    groups: list[list[TestNumbers]] = []
    records: set[str] = set()
    for test in tests:
        rate, record = test.specific_wear_rate, test.test.record.sha256
        if not test.part.steady or rate is None or rate.value <= 0.0 or record in records:
            continue
        records.add(record)
        group = next((g for g in groups if _same(g[0].conditions, test.conditions)), None)
        if group is None:
            groups.append([test])
        else:
            group.append(test)
    return tuple(_repeats(group) for group in groups if len(group) > 1)


def _same(a: Conditions, b: Conditions) -> bool:
    pairs = ((a.force, b.force), (a.omega, b.omega), (a.area, b.area))
    return all(abs(x - y) <= _SAME * max(abs(x), abs(y)) for x, y in pairs)


def _repeats(tests: Sequence[TestNumbers]) -> Repeats:
    rates = [test.specific_wear_rate for test in tests if test.specific_wear_rate]
    logarithms, n = np.log([rate.value for rate in rates]), len(rates)
    s_r = float(logarithms.std(ddof=1))
    shared = float(np.mean([rate.u_shared / rate.value for rate in rates]))
    half = np.hypot(student.ppf(_LEVEL, n - 1) * s_r / np.sqrt(n), COVERAGE * shared)
    low, middle, high = np.exp(logarithms.mean() + half * np.array([-1.0, 0.0, 1.0])).tolist()
    return Repeats(tuple(test.name for test in tests), middle, (low, high), s_r)
