"""Reasons not to take the numbers of a fit as they are."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ringwear_par.errors import ValidityWarning
from ringwear_par.identification.estimation.conditions import conditional_verdicts
from ringwear_par.identification.estimation.record_checks import record_warnings
from ringwear_par.identification.fit_rows import counted
from ringwear_par.identification.scatter.disagreement import disagreements

if TYPE_CHECKING:
    from ringwear_par.identification.fit_result import FitResult

#: of chi2 over its readings, of a series that stands out
_HIGH = 2.0
#: sd, from which on readings do not belong to the others; what share of these they may be
_FAR, _SHARE, _LISTED = 6.0, 0.1, 4


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
    for one in fit.parameters:
        at_bound = one.key in fit.keys_at_bound
        if one.verdict == "not identified":
            bound = "; the estimate is at its bound" * at_bound
            text = f"{one.key} is not identified: {one.direction}{bound}"
        elif one.verdict == "at bound" and at_bound:
            text = f"{one.key} = {one.estimate:g} is at its bound; its interval has one limit only"
        elif one.verdict == "at bound":
            text = f"the readings give {one.key} only a limit on one side"
        else:
            continue
        yield ValidityWarning(one.verdict.replace(" ", "-"), text, (one.key,))


def _of_the_model(fit: "FitResult") -> Iterator[ValidityWarning]:
    """Yield doubts about a model that does not fit, all readings or some."""
    if fit.flagged:
        text = (
            f"the model does not fit: chi2 = {fit.tested_chi2[0]:.4g} of "
            f"{fit.tested_chi2[1]:.4g} degrees of freedom (p = {fit.p_value:.1g}); the noise is "
            "larger than its sd, or the wear law is another"
        )
        yield ValidityWarning("does-not-fit", text)
        if fit.alternatives and all(other.flagged for other in fit.alternatives.values()):
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
            continue  # most of them are off
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
        covariance = fit.material.unbounded.covariance
        narrowed = [one.key for one in fit.parameters]
    return conditional_verdicts(fit.parameters, covariance, narrowed, fit.keys_at_bound)


def _of_the_search(fit: "FitResult") -> Iterator[ValidityWarning]:
    """Yield doubts about starts, time steps, ends of intervals and samples."""
    if fit.starts:
        best = min(fit.starts, key=lambda start: start.objective)
        if not best.converged:
            text = "the best start has not converged: these numbers are where its search ended"
            yield ValidityWarning("not-converged", text)
        if failed := [one for one in fit.starts if one.error]:
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
    """Return the doubts about units that nobody names, or that are likely wrong."""
    return [
        ValidityWarning(
            "assumed-unit", f"{series.name} ({experiment.name}): {sentence}", (), (experiment.name,)
        )
        for experiment, series, _ in fit.misfit.records
        for sentence in series.assumptions + series.suspicions
    ] + [
        ValidityWarning(
            "assumed-unit", f"{one.key} ({experiment.name}): {sentence}", (), (experiment.name,)
        )
        for experiment in fit.misfit.problem.experiments
        for one in experiment.inputs
        for sentence in one.assumptions + one.suspicions
    ]
