"""Warnings about a fit: reasons not to trust its numbers as they are."""

import itertools
from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.stats import chi2

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ValidityWarning, counted
from ringwear_par.identification.definition.fitted_parameters import unit_of_key
from ringwear_par.identification.estimation.intervals import ParameterEstimate
from ringwear_par.identification.estimation.misfit import Evaluation, Misfit
from ringwear_par.identification.estimation.record_checks import record_warnings
from ringwear_par.identification.scatter.linearisation import Linearisation

if TYPE_CHECKING:
    from ringwear_par.identification.fit_result import FitResult

#: chi2 over the number of readings above which a series stands out
_HIGH = 2.0
#: sd above which readings do not belong to the others, the largest share of such readings, and how
#: many are listed
_FAR, _SHARE, _LISTED = 6.0, 0.1, 4
#: share of the sd with another key free below which an interval depends on the bound of that key
_NARROWED = 0.5
#: probability below which differences between tests are not due to chance
_NO_CHANCE = 0.01
#: share of the largest information of a test below which a test has none
_INFORMED = 1e-6
#: beginnings of keys of rates: other keys are settings of the machine
_RATES = ("wear.", "contact.friction")


def doubts(fit: "FitResult") -> tuple[ValidityWarning, ...]:
    """Return the doubts about a fit, those about its keys first."""
    return (
        *_of_keys(fit),
        *_of_the_model(fit),
        *_of_records(fit),
        *_conditions(fit),
        *_of_the_search(fit),
        *assumptions(fit),
    )


def _of_keys(fit: "FitResult") -> Iterator[ValidityWarning]:
    """Yield doubts about keys that are not identified, or at a bound."""
    for parameter in fit.parameters:
        at_bound = parameter.key in fit.keys_at_bound
        if parameter.verdict == "not identified":
            bound = "; the estimate is at its bound" * at_bound
            text = f"{parameter.key} is not identified: {parameter.direction}{bound}"
        elif parameter.verdict == "at bound" and at_bound:
            text = (
                f"{parameter.key} = {parameter.estimate:g} is at its bound; its interval has one "
                "limit only"
            )
        elif parameter.verdict == "at bound":
            text = f"the readings give {parameter.key} only a limit on one side"
        else:
            continue
        yield ValidityWarning(parameter.verdict.replace(" ", "-"), text, (parameter.key,))


def _of_the_model(fit: "FitResult") -> Iterator[ValidityWarning]:
    """Yield doubts about a model that does not fit, all readings or some."""
    if fit.flagged:
        text = (
            f"the model does not fit: chi2 = {fit.tested_chi2[0]:.4g} of "
            f"{fit.tested_chi2[1]:.4g} degrees of freedom (p = {fit.p_value:.1g}); the noise is "
            "larger than its sd, or the wear law is another"
        )
        yield ValidityWarning("does-not-fit", text)
        if fit.alternatives and all(
            alternative.flagged for alternative in fit.alternatives.values()
        ):
            yield ValidityWarning("no-law-fits", "none of the laws compared fits either")
    for experiment, series in fit.experiments.items():
        for name, entry in series.items():
            if entry["n"] > 5 and entry["chi2"] > _HIGH * entry["n"] and not entry.get("sd"):
                text = f"{name} ({experiment}): chi2 = {entry['chi2']:.4g} of {entry['n']} readings"
                yield ValidityWarning("series-does-not-fit", text, (), (experiment,))
    yield from _outliers(fit)


def _outliers(fit: "FitResult") -> Iterator[ValidityWarning]:
    """Yield a doubt for each series a few of whose readings do not fit at all, or limits hold."""
    misfit = fit.misfit
    for experiment, series, part in misfit.records:
        far, limit = np.abs(fit.evaluation.noise[part]), misfit.censored[part] != 0
        name = f"{series.name} ({experiment.name})"
        if (broken := far[limit & (far > _FAR)]).size:
            text = (
                f"{name}: the model is on the wrong side of {counted(len(broken), 'limit')}, by up "
                f"to {broken.max():.3g} sd; check censored and the unit"
            )
            yield ValidityWarning("outliers", text, (), (experiment.name,))
        far[limit] = 0.0
        few = np.argsort(-far)[: max(1, int(_SHARE * series.n))]
        worst = few[far[few] > _FAR]
        if series.sd_fitted or not len(worst):
            continue
        share = far[worst] @ far[worst] / (far @ far)
        if share < 0.5 and np.count_nonzero(far > _FAR) > len(worst):
            continue  # most readings are off
        if series.n == 1:
            text = f"{name}: is {far[0]:.3g} sd off the model; check its unit"
            yield ValidityWarning("outliers", text, (), (experiment.name,))
            continue
        listed = worst[:_LISTED]
        axis, unit = ("r", "mm") if series.profile else ("time", "s")
        at = ", ".join(f"{series.x[i]:.6g}" for i in np.sort(listed))
        more = "" if len(worst) <= _LISTED else f" and {len(worst) - _LISTED} more"
        stop = "; if they belong to an edge or a stop, exclude leaves them out"
        hint = stop if share > 0.5 else ""
        text = (
            f"{name}: {counted(len(worst), 'reading')} at {axis} = {at} {unit}{more}, up to "
            f"{far.max():.3g} sd off the model, make {100.0 * share:.3g} % of its chi2{hint}"
        )
        yield ValidityWarning("outliers", text, (), (experiment.name,))


def _of_records(fit: "FitResult") -> Iterator[ValidityWarning]:
    """Yield what records say against the model or the intervals."""
    misfit, x, evaluation, material = fit.misfit, fit.x, fit.evaluation, fit.material
    yield from record_warnings(misfit, x, evaluation)
    sizes = None
    if material is None:
        test_unknowns = np.tile(x[: len(fit.parameters)], (len(misfit.problem.experiments), 1))
    else:
        test_unknowns = material.test_unknowns
        if misfit.problem.settings.process:
            evaluation = misfit.evaluate(x, test_unknowns)
            sizes = material.sizes_of_process
    yield from disagreements(misfit, x, evaluation, test_unknowns, sizes)
    if material is not None:
        yield from material.warnings


def _conditions(fit: "FitResult") -> list[ValidityWarning]:
    """Return warnings about keys that are identified only while others are at their bounds."""
    m = len(fit.parameters)
    if fit.material is None:  # linear intervals are those with all keys free
        covariance, narrowed = fit.covariance[:m, :m], [*fit.profiles]
    else:
        covariance = fit.material.mixed.unbounded.covariance()
        narrowed = [parameter.key for parameter in fit.parameters]
    return conditional_verdicts(fit.parameters, covariance, narrowed, fit.keys_at_bound)


def _of_the_search(fit: "FitResult") -> Iterator[ValidityWarning]:
    """Yield doubts about starts, time steps, ends of intervals and samples."""
    if fit.starts:
        best = min(fit.starts, key=lambda start: start.objective)
        if not best.converged:
            text = "the best start has not converged: these numbers are where its search ended"
            yield ValidityWarning("not-converged", text)
        if failed := [start for start in fit.starts if start.error]:
            text = f"{len(failed)} of {len(fit.starts)} starts failed: {failed[0].error}"
            yield ValidityWarning("starts-failed", text)
    for key in fit.step_dependent_keys:
        shift = fit.discretisation_shift_sd[key]
        text = f"{key}: time steps half as long would move it by {shift:.2g} sd"
        yield ValidityWarning("step-dependent", text, (key,))
    for key in fit.inexact_limits:
        text = (
            f"{key}: an end of its likelihood-profile interval is approximate or missing: the laws "
            "do not allow values there, or histories could not be computed"
        )
        yield ValidityWarning("inexact-limit", text, (key,))
    if fit.posterior is not None and fit.posterior.few:
        text = (
            f"the posterior's samples are worth only {fit.posterior.effective:.0f} independent "
            "ones: increase fit.samples"
        )
        yield ValidityWarning("few-samples", text)


def assumptions(fit: "FitResult") -> list[ValidityWarning]:
    """Return the doubts about units that no name has, or that are likely wrong."""
    problem = fit.misfit.problem
    every = [(experiment, series) for experiment, series, _ in fit.misfit.records]
    every += [(test, entry.series) for test in problem.experiments for entry in test.inputs]
    return [
        ValidityWarning(
            "assumed-unit", f"{series.name} ({experiment.name}): {sentence}", (), (experiment.name,)
        )
        for experiment, series in every
        for sentence in series.assumptions + series.suspicions
    ]


def conditional_verdicts(
    estimates: Sequence[ParameterEstimate],
    covariance: FloatArray,
    narrowed: Collection[str],
    keys_at_bound: Collection[str],
) -> list[ValidityWarning]:
    """Return warnings about keys that are identified only while others are at their bounds.

    The covariance (m, m) is as if there were no bounds; ``narrowed`` are keys whose intervals are
    those with the others within their bounds, ``keys_at_bound`` those whose estimate is one.
    """
    known = [j for j in range(len(estimates)) if np.isfinite(covariance[j, j])]
    at_bounds = [
        j for j in known if estimates[j].verdict == "at bound" and estimates[j].key in keys_at_bound
    ]

    def sd(j: int, fixed: Sequence[int]) -> float:
        """Return the sd of an unknown where some others are known."""
        across = covariance[j, fixed]
        inverse = np.linalg.pinv(covariance[np.ix_(fixed, fixed)], hermitian=True)
        return float(np.sqrt(max(covariance[j, j] - across @ inverse @ across, 0.0)))

    warnings = []
    for j, i in itertools.product(known, at_bounds):
        estimate, at_bound, narrow = estimates[j], estimates[i], sd(j, at_bounds)
        if estimate.verdict != "identified" or estimate.key not in narrowed or narrow == 0.0:
            continue
        growth = sd(j, [other for other in at_bounds if other != i]) / narrow
        if _NARROWED * growth <= 1.0:
            continue
        text = (
            f"{estimate.key} is identified only if {at_bound.key} = {at_bound.estimate:g}, its "
            f"bound: with that free its sd is {growth:.2g} times as large"
        )
        keys, values = (estimate.key, at_bound.key), {"growth_of_sd": growth}
        warnings.append(ValidityWarning("conditional-verdict", text, keys, (), values))
    return warnings


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

    Of those that the fit file does not let scatter; sizes (bodies,) mm are of the process noise.
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
