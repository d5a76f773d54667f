"""A fit in a few lines of text: the estimates, then what speaks against them, then the rest."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ringwear_par.identification.estimation.posterior import FEW, Posterior, missing_package
from ringwear_par.identification.fit_numbers import (
    counted,
    goodness,
    law_rows,
    series_rows,
    unit_suffix,
    value_text,
)
from ringwear_par.identification.fit_result import FitResult
from ringwear_par.identification.model.steps import MOST_SHIFT_SD

#: correlations that are listed
_STRONG = 0.9
#: of chi2 over its readings, of a series that stands out
_HIGH = 2.0
#: sd, from which on readings do not belong to the others; what share of these they may be
_FAR, _SHARE, _LISTED = 6.0, 0.1, 4


def warnings(fit: FitResult) -> tuple[str, ...]:
    """Return reasons not to take the numbers as they are, a sentence each."""
    sentences = []
    for one in fit.parameters:
        if one.verdict == "not identified":
            bound = "; its estimate is at its bound" if one.key in fit.keys_at_bound else ""
            sentences.append(f"{one.key} is not identified: {one.direction}{bound}")
        elif one.verdict == "at bound":
            sentences.append(
                f"{one.key} = {one.estimate:g} is at its bound; its limit is one-sided"
            )
    if fit.flagged:
        sentences.append(
            f"the model does not fit: chi2 = {fit.tested_chi2[0]:.4g} of "
            f"{fit.tested_chi2[1]:.4g} degrees of freedom (p = {fit.p_value:.1g}); noise larger "
            "than its sd, or another law"
        )
        if fit.alternatives and all(other.flagged for other in fit.alternatives.values()):
            sentences.append("none of the laws compared fits either")
    for experiment, series in fit.experiments.items():
        for name, entry in series.items():
            if entry["n"] > 5 and entry["chi2"] > _HIGH * entry["n"] and not entry.get("sd"):
                sentences.append(
                    f"{name} ({experiment}): chi2 = {entry['chi2']:.4g} of {entry['n']} readings"
                )
    sentences += _outliers(fit)
    sentences += [doubt.text for doubt in fit.doubts]
    if fit.starts:
        best = min(fit.starts, key=lambda start: start.objective)
        if not best.converged:
            sentences.append("the best start has not converged; its numbers are the best there are")
        failed = [one for one in fit.starts if one.error]
        if failed:
            sentences.append(f"{len(failed)} of {len(fit.starts)} starts failed: {failed[0].error}")
    sentences += [
        f"{key}: steps half as long would move it by {discretisation_shift_sd:.2g} sd"
        for key, discretisation_shift_sd in fit.discretisation_shift_sd.items()
        if abs(discretisation_shift_sd) > MOST_SHIFT_SD
    ]
    sentences += [
        f"{key}: a limit of its likelihood profile is only near the level, or none was found: the "
        "laws do not allow such values, or no history could be computed there"
        for key in fit.inexact_limits
    ]
    if fit.posterior is not None and fit.posterior.effective < FEW:
        sentences.append(
            f"the posterior's samples are worth {fit.posterior.effective:.0f} only: more samples"
        )
    return (*sentences, *_assumptions(fit))


def _assumptions(fit: FitResult) -> list[str]:
    """Return the sentences about columns whose unit nobody names."""
    return [
        f"{series.name} ({experiment.name}): {sentence}"
        for experiment, series in fit.misfit.series
        for sentence in series.assumptions
    ]


def _outliers(fit: FitResult) -> list[str]:
    """Return which few readings do not fit at all, a sentence a series."""
    sentences = []
    misfit = fit.misfit
    for (experiment, series), part in zip(misfit.series, misfit.parts, strict=True):
        far = np.abs(fit.evaluation.noise[part])
        few = np.argsort(-far)[: max(1, int(_SHARE * series.n))]
        worst = few[far[few] > _FAR]
        if series.sd_fitted or not len(worst):
            continue
        name, share = f"{series.name} ({experiment.name})", far[worst] @ far[worst] / (far @ far)
        if share < 0.5 and np.count_nonzero(far > _FAR) > len(worst):
            continue  # most of them are off
        if series.n == 1:
            sentences.append(f"{name}: is {far[0]:.3g} sd off the model; look at its unit")
            continue
        listed = worst[:_LISTED]
        axis, unit = ("r", "mm") if series.profile else ("time", "s")
        at = ", ".join(f"{series.x[i]:.6g}" for i in np.sort(listed))
        more = "" if len(worst) <= _LISTED else f" and {len(worst) - _LISTED} more"
        hint = "; at an edge or a stop, exclude leaves them out" if share > 0.5 else ""
        sentences.append(
            f"{name}: {counted(len(worst), 'reading')} at {axis} = {at} {unit}{more}, up to "
            f"{far.max():.3g} sd off the model, make {100.0 * share:.3g} % of its chi2{hint}"
        )
    return sentences


def summary(fit: FitResult) -> str:
    """Return the outcome in a few lines: the estimates, what speaks against them, the rest."""
    problem, outcome = fit.misfit.problem, fit.to_dict()
    lines = [
        f"{problem.name}: {counted(fit.n, 'reading')} in "
        f"{counted(len(problem.experiments), 'experiment')}, "
        f"{counted(len(fit.parameters), 'parameter')}, {fit.histories} histories"
        + (f" ({fit.histories_of_profiles} for profiles)" if fit.profiles else ""),
        *_parameter_lines(outcome),
    ]
    if fit.posterior is not None:
        lines += _posterior_lines(fit, fit.posterior, outcome)
    lines += [f"warning: {sentence}" for sentence in fit.warnings]
    lines.append(goodness(outcome))
    for row in series_rows(outcome):
        noise = "" if row.noise is None else f", noise {row.noise:.3g} {row.unit}"
        lines.append(
            f"  {row.experiment}, {row.name}: {counted(row.n, 'reading')}, chi2 {row.chi2:.4g}"
            f"{noise}{row.nuisances and ', ' + row.nuisances}"
        )
    lines += _correlation_lines(fit)
    if fit.starts:
        converged = min(fit.starts, key=lambda start: start.objective).converged
        where = "at this optimum" if converged else "here"
        lines.append(f"{fit.n_at_best} of {counted(len(fit.starts), 'start')} end {where}")
    if fit.alternatives or fit.failed:
        lines += _law_lines(outcome)
    if shifts := fit.discretisation_shift_sd:
        most = max(shifts, key=lambda key: abs(shifts[key]))
        lines.append(f"steps half as long would move {most} by {shifts[most]:.2g} sd")
    return "\n".join(lines)


def prediction(fit: FitResult) -> str:
    """Return the summary of a fit whose optimum is the start, with nothing fitted."""
    problem = fit.misfit.problem
    lines = [
        f"{problem.name}: {counted(fit.n, 'reading')} in "
        f"{counted(len(problem.experiments), 'experiment')}; to be expected if the parameters are "
        "those of the start (nothing written):"
    ]
    lines += [f"warning: {sentence}" for sentence in _assumptions(fit)]
    lines += _parameter_lines(fit.to_dict())
    for one in fit.parameters:
        if one.direction:
            lines.append(f"  {one.key} would not be identified: {one.direction}")
    lines += _unit_lines(fit)
    lines += _correlation_lines(fit)
    settings = problem.settings
    lines.append(
        f"to be done: {settings.starts} starts by {settings.method}, intervals: "
        f"{', '.join(settings.intervals)}"
    )
    if missing := missing_package(settings.intervals):
        lines.append(f"missing: {missing}")
    if problem.alternatives:
        lines.append(f"to be compared: {', '.join(problem.alternatives)}")
    return "\n".join(lines)


def _parameter_lines(outcome: Mapping[str, Any]) -> list[str]:
    level, parameters = outcome["level"], outcome["parameters"]
    width, lines = max(map(len, parameters)), []
    for key, estimate in parameters.items():
        text, (low, high) = value_text(estimate), estimate["interval"]
        if low is not None and high is not None:
            limits = f"from {low:.5g} to {high:.5g}"
        elif low is None and high is None:
            limits = "no limit within its bounds"
        else:
            limits = f"less than {high:.5g}" if high is not None else f"more than {low:.5g}"
        by = ", likelihood profile" * (estimate["interval_of"] == "likelihood profile")
        if estimate["verdict"] != "not identified":
            text += f"  {limits} ({100 * level:g} %{by})"
        lines.append(f"  {key.ljust(width)}  {text}  {estimate['verdict']}")
    return lines


def _posterior_lines(fit: FitResult, posterior: Posterior, outcome: Mapping[str, Any]) -> list[str]:
    parameters, level = outcome["parameters"], outcome["level"]
    width = max(map(len, parameters))
    lines = [
        f"posterior: {len(posterior.samples)} samples worth {posterior.effective:.0f}, "
        f"{100.0 * posterior.acceptance:.0f} % of the moves accepted"
        + ("; fitted noise stays what it is at the best fit" if fit.noise_fitted else "")
    ]
    for key, estimate in parameters.items():
        sampled = estimate["posterior"]
        low, high = sampled["interval"]
        lines.append(
            f"  {key.ljust(width)}  {sampled['median']:.5g}{unit_suffix(estimate['unit'])}  "
            f"from {low:.5g} to {high:.5g} ({100 * level:g} %)"
        )
    return lines


def _unit_lines(fit: FitResult) -> list[str]:
    lines = []
    for experiment, series in fit.misfit.series:
        spread = np.median(series.sd) / series.factor
        lines.append(
            f"  {experiment.name}, {series.name}: {counted(series.n, 'reading')} in {series.unit}, "
            "noise "
            f"{spread:.3g}{' (guessed, to be fitted)' if series.sd_fitted else ''}"
        )
    return lines


def _correlation_lines(fit: FitResult) -> list[str]:
    strong = [pair for pair in fit.correlations() if abs(pair[2]) > _STRONG]
    return [f"correlated by {value:+.3f}: {one} and {other}" for one, other, value in strong[:5]]


def _law_lines(outcome: Mapping[str, Any]) -> list[str]:
    rows = law_rows(outcome)
    lines = ["laws compared (AIC over the smallest, BIC, chi2, parameters):"]
    for row in rows:
        if row.aic_difference is None:
            lines.append(f"  {row.name}: {row.verdict}")
            continue
        flag = "; does not fit" * (row.verdict == "does not fit")
        lines.append(
            f"  {row.name}: {row.aic_difference:+.1f}, {row.bic:.5g}, {row.chi2:.5g}; "
            f"{row.parameters}{flag}"
        )
    if all(row.aic_difference is None or row.verdict == "does not fit" for row in rows):
        lines.append("  none of them fits")
    return lines
