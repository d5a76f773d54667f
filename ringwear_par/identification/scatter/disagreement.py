"""Tests that disagree: values of a key that differ by more than readings explain."""

from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.definition.fitted_parameters import unit_of_key
from ringwear_par.identification.estimation.misfit import Evaluation, Misfit
from ringwear_par.identification.estimation.record_checks import FitWarning
from ringwear_par.identification.scatter.linearisation import Linearisation

#: probability below which what tests differ by is no chance
_NO_CHANCE = 0.01
#: keys of rates: other numbers are the machine's
_RATES = ("wear.", "contact.friction")


class _Heterogeneity(NamedTuple):
    """Cochran's Q of a key, its degrees of freedom, and the scatter that explains it."""

    q: float
    freedom: int
    scatter: float

    @property
    def probability(self) -> float:
        """Probability of so large a Q where tests do not differ."""
        return float(chi2.sf(self.q, self.freedom)) if self.freedom else 1.0


def disagreements(
    misfit: Misfit, x: FloatArray, evaluation: Evaluation, test_unknowns: FloatArray
) -> list[FitWarning]:
    """Return warnings about keys of rates whose values differ between tests, and do not scatter.

    Parameters
    ----------
    x, evaluation, test_unknowns : unknowns (u,), residuals, and (tests, m) of the keys.
    """
    problem = misfit.problem
    if len(problem.experiments) < 2:
        return []
    linear = Linearisation(misfit, x)
    reduced, free = linear.reduced(evaluation, x, test_unknowns), list(linear.free)
    score = np.array(
        [
            test.score - test.information @ o
            for test, o in zip(reduced, test_unknowns[:, free], strict=True)
        ]
    )
    information = np.array([np.diag(test.information) for test in reduced])
    conditions = defaultdict(list)
    for i, experiment in enumerate(problem.experiments):
        conditions[experiment.case.text].append(i)
    warnings = []
    for place, key in enumerate(free):
        parameter = problem.parameters[key]
        if parameter.scatter is not None or not parameter.key.startswith(_RATES):
            continue
        informed = np.flatnonzero(information[:, place] > 0.0)
        s, a = score[:, place], information[:, place]
        alike = _heterogeneity(
            s, a, [[i for i in tests if a[i] > 0.0] for tests in conditions.values()]
        )
        all_tests = _heterogeneity(s, a, [informed.tolist()])
        equal = alike.probability < _NO_CHANCE
        heterogeneity = alike if equal else all_tests
        if heterogeneity.probability >= _NO_CHANCE:
            continue
        own_sd = float(np.median(a[informed] ** -0.5))
        unit = "" if parameter.log else unit_of_key(problem, parameter.key)
        text = (
            f"{parameter.key} scatters between tests of {'equal' if equal else 'different'} "
            f"conditions by {_size(heterogeneity.scatter, parameter.log)}{unit} "
            "(DerSimonian-Laird), but the readings explain only "
            f'{_size(own_sd, parameter.log)}{unit}: use scatter = "fit"'
            f"{'' if equal else ', or another law'}"
        )
        values = {**heterogeneity._asdict(), "p": heterogeneity.probability, "readings": own_sd}
        names = tuple(problem.experiments[i].name for i in informed.tolist())
        warnings.append(FitWarning("tests-disagree", text, names, (parameter.key,), values))
    return warnings


def _heterogeneity(
    score: FloatArray, information: FloatArray, groups: Sequence[Sequence[int]]
) -> _Heterogeneity:
    """Return the heterogeneity within groups of tests."""
    q, freedom, size = 0.0, 0, 0.0
    for tests in groups:
        if len(tests) < 2:
            continue
        s, a = score[list(tests)], information[list(tests)]
        q += float((s**2 / a).sum() - s.sum() ** 2 / a.sum())
        freedom += len(tests) - 1
        size += float(a.sum() - (a**2).sum() / a.sum())
    scatter = np.sqrt(max(q - freedom, 0.0) / size) if size > 0.0 else 0.0
    return _Heterogeneity(q, freedom, float(scatter))


def _size(size: float, log: bool) -> str:
    """Return a standard deviation of an unknown in words."""
    return f"{100.0 * size:.2g} %" if log else f"{size:.2g}"
