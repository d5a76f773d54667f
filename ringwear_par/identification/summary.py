"""A fit in the words of who made the test, what is doubtful first."""

import numpy as np

from ringwear_par.identification.definition.fitted_parameters import units_of
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.estimation.intervals import ParameterEstimate
from ringwear_par.identification.estimation.posterior import FEW, Posterior, missing_package
from ringwear_par.identification.estimation.starts import StartOutcome
from ringwear_par.identification.fit_result import FitResult
from ringwear_par.identification.model.steps import MOST_SHIFT_SD

#: correlations that are told
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
            sentences.append(f"{one.key} is not identified: {one.direction}")
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
        best = min(fit.starts, key=_objective)
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
            f"{name}: {_count(len(worst), 'reading')} at {axis} = {at} {unit}{more}, up to "
            f"{far.max():.3g} sd off the model, make {100.0 * share:.3g} % of its chi2{hint}"
        )
    return sentences


def _objective(one: StartOutcome) -> float:
    return one.objective


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def summary(fit: FitResult) -> str:
    """Return the outcome in a few lines."""
    problem = fit.misfit.problem
    lines = [
        f"{problem.name}: {_count(fit.n, 'reading')} in "
        f"{_count(len(problem.experiments), 'experiment')}, "
        f"{_count(len(fit.parameters), 'parameter')}, {fit.histories} histories"
        + (f" ({fit.histories_of_profiles} for profiles)" if fit.profiles else "")
    ]
    lines += [f"warning: {sentence}" for sentence in fit.warnings]
    lines += _parameter_lines(fit)
    if fit.posterior is not None:
        lines += _posterior_lines(fit, fit.posterior)
    lines.append(_fit_line(fit))
    lines += _series_lines(fit)
    lines += _correlation_lines(fit)
    if fit.starts:
        where = "at this optimum" if min(fit.starts, key=_objective).converged else "here"
        lines.append(f"{fit.n_at_best} of {_count(len(fit.starts), 'start')} end {where}")
    if fit.alternatives or fit.failed:
        lines += _alternative_lines(fit)
    if fit.discretisation_shift_sd:
        most = max(
            fit.discretisation_shift_sd, key=lambda key: abs(fit.discretisation_shift_sd[key])
        )
        lines.append(
            f"steps half as long would move {most} by {fit.discretisation_shift_sd[most]:.2g} sd"
        )
    return "\n".join(lines)


def prediction(fit: FitResult) -> str:
    """Return the summary of a fit whose optimum is the start, with nothing fitted."""
    problem = fit.misfit.problem
    lines = [
        f"{problem.name}: {_count(fit.n, 'reading')} in "
        f"{_count(len(problem.experiments), 'experiment')}; to be expected if the parameters are "
        "those of the start (nothing written):"
    ]
    lines += [f"warning: {sentence}" for sentence in _assumptions(fit)]
    lines += _parameter_lines(fit)
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


def unit_of(problem: Problem, key: str) -> str:
    """Return the unit of a fitted key, with a blank before it; "" for none."""
    unit = units_of(problem)[key]
    return "" if unit in ("1", "-") else f" {unit}"


def _parameter_lines(fit: FitResult) -> list[str]:
    width = max(len(one.key) for one in fit.parameters)
    problem = fit.misfit.problem
    return [
        f"  {p.key.ljust(width)}  {_estimate_text(p, problem, profiled=p.key in fit.profiles)}"
        for p in fit.parameters
    ]


def _estimate_text(one: ParameterEstimate, problem: Problem, *, profiled: bool) -> str:
    level, (low, high) = problem.settings.level, one.interval
    value = _value_text(one, problem)
    if one.verdict == "not identified":
        return f"{value}  not identified"
    if low is not None and high is not None:
        limits = f"from {low:.5g} to {high:.5g}"
    elif low is None and high is None:
        limits = "no limit within its bounds"
    else:
        limits = f"less than {high:.5g}" if high is not None else f"more than {low:.5g}"
    by = ", likelihood profile" if profiled else ""
    return f"{value}  {limits} ({100 * level:g} %{by})  {one.verdict}"


def _value_text(one: ParameterEstimate, problem: Problem) -> str:
    """Return an estimate with its standard deviation, if it has one, and its unit."""
    known = one.sd is not None and one.verdict == "identified"
    spread = f" +- {one.sd:.2g}" if known else ""
    return f"{one.estimate:.5g}{spread}{unit_of(problem, one.key)}"


def _posterior_lines(fit: FitResult, posterior: Posterior) -> list[str]:
    problem = fit.misfit.problem
    level, width = problem.settings.level, max(len(p.key) for p in fit.parameters)
    lines = [
        f"posterior: {len(posterior.samples)} samples worth {posterior.effective:.0f}, "
        f"{100.0 * posterior.acceptance:.0f} % of the moves accepted"
        + ("; fitted noise stays what it is at the best fit" if fit.noise_fitted else "")
    ]
    for j, (low, high) in enumerate(posterior.interval(level).T.tolist()):
        one, middle = fit.parameters[j], float(np.median(posterior.samples[:, j]))
        lines.append(
            f"  {one.key.ljust(width)}  {middle:.5g}{unit_of(problem, one.key)}  from {low:.5g} to "
            f"{high:.5g} ({100 * level:g} %)"
        )
    return lines


def _fit_line(fit: FitResult) -> str:
    probable = "no p-value"
    if fit.p_value is not None:
        probable = f"p = {fit.p_value:.2g}"
        if fit.noise_fitted:
            probable += " of those whose noise is given"
    elif fit.noise_fitted:
        probable = "all noise was fitted"
    elif fit.misfit.problem.settings.loss == "student":
        probable = 'loss "student"'
    return (
        f"chi2 = {fit.chi2:.5g} of {fit.n} readings, {fit.freedom} degrees of freedom "
        f"({probable}); AIC {fit.aic:.5g}, BIC {fit.bic:.5g}"
    )


def _series_lines(fit: FitResult) -> list[str]:
    nuisances, lines = fit.nuisances, []
    for experiment, series in fit.experiments.items():
        for name, entry in series.items():
            unit = entry["unit"]
            line = (
                f"  {experiment}, {name}: {_count(entry['n'], 'reading')}, chi2 {entry['chi2']:.4g}"
            )
            if "sd" in entry:
                line += f", noise {entry['sd']:.3g} {unit}"
            for kind, estimate in nuisances.get(experiment, {}).get(name, {}).items():
                if estimate["sd"] is None:
                    line += f", {kind} not told"
                else:
                    per = {"compliance": "/kN", "tilt": "/mm"}.get(kind, "")
                    line += (
                        f", {kind} {estimate['estimate']:.3g} +- {estimate['sd']:.2g} {unit}{per}"
                    )
            lines.append(line)
    return lines


def _unit_lines(fit: FitResult) -> list[str]:
    lines = []
    for experiment, series in fit.misfit.series:
        spread = np.median(series.sd) / series.factor
        lines.append(
            f"  {experiment.name}, {series.name}: {_count(series.n, 'reading')} in {series.unit}, "
            "noise "
            f"{spread:.3g}{' (guessed, to be fitted)' if series.sd_fitted else ''}"
        )
    return lines


def _correlation_lines(fit: FitResult) -> list[str]:
    strong = [pair for pair in fit.correlations() if abs(pair[2]) > _STRONG]
    return [f"correlated by {value:+.3f}: {one} and {other}" for one, other, value in strong[:5]]


def _alternative_lines(fit: FitResult) -> list[str]:
    laws = {"this law": fit, **fit.alternatives}
    best = min(other.aic for other in laws.values())
    lines = ["laws compared (AIC over the smallest, BIC, chi2, parameters):"]
    for name, other in sorted(laws.items(), key=lambda item: item[1].aic):
        values = ", ".join(
            f"{p.key} = {_value_text(p, other.misfit.problem)}" for p in other.parameters
        )
        flag = "; does not fit" if other.flagged else ""
        lines.append(
            f"  {name}: {other.aic - best:+.1f}, {other.bic:.5g}, {other.chi2:.5g}; {values}{flag}"
        )
    lines += [f"  {name}: failed: {reason}" for name, reason in fit.failed.items()]
    if all(other.flagged for other in laws.values()):
        lines.append("  none of them fits")
    return lines
