"""Tests that disagree: values of a key that differ by more than readings explain."""

from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ValidityWarning
from ringwear_par.identification.definition.fitted_parameters import unit_of_key
from ringwear_par.identification.estimation.misfit import Evaluation, Misfit
from ringwear_par.identification.scatter.linearisation import Linearisation

#: probability below which what tests differ by is no chance
_NO_CHANCE = 0.01
#: of the largest information of a test: less is none
_INFORMED = 1e-6
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
    misfit: Misfit,
    x: FloatArray,
    evaluation: Evaluation,
    test_unknowns: FloatArray,
    sizes: FloatArray | None = None,
) -> list[ValidityWarning]:
    """Return a warning about the key of a rate whose values differ most between tests.

    Of those that the fit file does not let scatter.

    Parameters
    ----------
    x, evaluation, test_unknowns : unknowns (u,), residuals, and (tests, m) of the keys.
    sizes : (bodies,) mm, of the process noise; None: there is none.
    """
    problem = misfit.problem
    if len(problem.experiments) < 2:
        return []
    linear = Linearisation(misfit, evaluation, x, test_unknowns)
    (reduced,) = linear.reduced(None if sizes is None else sizes[None])
    score = np.array(
        [r.score - r.information @ o for r, o in zip(reduced, test_unknowns, strict=True)]
    )
    information = np.array([np.diag(test.information) for test in reduced])
    conditions = defaultdict(list)
    for i, experiment in enumerate(problem.experiments):
        conditions[experiment.conditions].append(i)
    warnings = []
    for key, parameter in enumerate(problem.parameters):
        at_bound = not misfit.lower[key] < x[key] < misfit.upper[key]
        if parameter.scatter is not None or at_bound or not parameter.key.startswith(_RATES):
            continue
        s, a = score[:, key], information[:, key]
        informed = np.flatnonzero(a > _INFORMED * a.max()).tolist()
        alike = _heterogeneity(
            s, a, [[i for i in tests if i in informed] for tests in conditions.values()]
        )
        all_tests = _heterogeneity(s, a, [informed])
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
        names = tuple(problem.experiments[i].name for i in informed)
        warnings.append(ValidityWarning("tests-disagree", text, (parameter.key,), names, values))
    # one that scatters makes the others look as if they did
    return sorted(warnings, key=lambda warning: -warning.values["q"])[:1]


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
