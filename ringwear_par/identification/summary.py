"""A fit as people read it: rows of numbers for its page, warnings, and the text of its summary.

Functions of an ``outcome`` take the contents of fit.json (``FitResult.to_dict``).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.cases.units import CUSTOMARY
from ringwear_par.errors import warning_lines
from ringwear_par.identification.definition.problem import body_of_wear
from ringwear_par.identification.definition.scatter import PLURALS
from ringwear_par.identification.evidence import probabilities
from ringwear_par.identification.scatter.material import known_sizes

if TYPE_CHECKING:
    from ringwear_par.identification.estimation.posterior import Posterior
    from ringwear_par.identification.fit_result import FitResult

Outcome = Mapping[str, Any]

#: units of nuisances, after that of their readings
_PER = {"compliance": "/kN", "tilt": "/mm"}

#: correlations that are listed
_STRONG = 0.9
#: of chi2 over its readings, of a series that stands out
_HIGH = 2.0
#: sd, from which on readings do not belong to the others; what share of these they may be
_FAR, _SHARE, _LISTED = 6.0, 0.1, 4


@dataclass(frozen=True)
class SeriesRow:
    """A series of readings and its misfit; ``noise`` is None unless it was fitted."""

    experiment: str
    name: str
    n: int
    chi2: float
    unit: str
    noise: float | None
    nuisances: str


@dataclass(frozen=True)
class LawRow:
    """A law that was compared; numbers are None where its fit failed."""

    name: str
    aic_difference: float | None
    bic: float | None
    probability: float | None
    chi2: float | None
    parameters: str
    verdict: str


def counted(number: int, noun: str) -> str:
    """Return a number with its noun."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def unit_suffix(unit: str) -> str:
    """Return a unit with a blank before it; "" for none."""
    return "" if unit in ("1", "-") else f" {unit}"


def value_text(estimate: Mapping[str, Any]) -> str:
    """Return an estimate with its unit, and with its standard uncertainty where it has one."""
    sd = estimate["sd"] if estimate["verdict"] == "identified" else None
    return _with_sd(estimate["estimate"], sd, 5, unit_suffix(estimate["unit"]))


def goodness(outcome: Outcome) -> str:
    """Return chi2, degrees of freedom, p-value and information criteria in a sentence."""
    p_value = outcome["p_value"]
    noise_fitted = any(row.noise is not None for row in series_rows(outcome))
    if p_value is not None:
        test = f"p = {p_value:.2g}" + " for the readings with a given sd" * noise_fitted
    elif noise_fitted:
        test = "no p-value, as all noise was fitted"
    else:
        test = 'loss "student"' if outcome["loss"] == "student" else "no p-value"
    return (
        f"chi2 = {outcome['chi2']:.5g} of {outcome['n_data']} readings, "
        f"{outcome['degrees_of_freedom']:.6g} degrees of freedom ({test}); "
        f"AIC {outcome['aic']:.5g}, BIC {outcome['bic']:.5g}"
    )


def series_rows(outcome: Outcome) -> Iterator[SeriesRow]:
    """Yield the series of all experiments, with their nuisances."""
    for experiment, series in outcome["experiments"].items():
        fitted = outcome["nuisance"].get(experiment, {})
        for name, entry in series.items():
            unit = entry["unit"]
            nuisances = ", ".join(
                _nuisance(kind, nuisance, f"{unit}{_PER.get(kind, '')}")
                for kind, nuisance in fitted.get(name, {}).items()
            )
            yield SeriesRow(
                experiment, name, entry["n"], entry["chi2"], unit, entry.get("sd"), nuisances
            )


def _nuisance(kind: str, entry: Outcome, unit: str) -> str:
    if entry["sd"] is None:
        return f"{kind} not identified"
    words = f"{kind} {_with_sd(entry['estimate'], entry['sd'], 3, f' {unit}')}"
    return f"{words} in {_nuisance('time', entry['time'], 's')}" if "time" in entry else words


def law_rows(outcome: Outcome) -> list[LawRow]:
    """Return the laws that were compared, the best by AIC first, those that failed last."""
    laws = {"this law": outcome, **outcome["alternatives"]}
    solved = {name: law for name, law in laws.items() if "aic" in law}
    best = min(law["aic"] for law in solved.values())
    evidences = {name: law.get("log_evidence") for name, law in solved.items()}
    shares = probabilities(evidences) if None not in evidences.values() else {}
    rows = []
    for name, law in sorted(solved.items(), key=lambda item: item[1]["aic"]):
        parameters = ", ".join(f"{key} = {value_text(p)}" for key, p in law["parameters"].items())
        verdict = "does not fit" if law["flagged"] else "fits"
        if law["p_value"] is None:
            verdict = "not tested: noise was fitted, or has long tails"
        numbers = law["aic"] - best, law["bic"], shares.get(name), law["chi2"]
        rows.append(LawRow(name, *numbers, parameters, verdict))
    rows += [
        LawRow(name, None, None, None, None, "", f"failed: {law['error']}")
        for name, law in laws.items()
        if name not in solved
    ]
    return rows


def _with_sd(value: float, sd: float | None, digits: int, unit: str) -> str:
    return f"{value:.{digits}g}{unit}" + ("" if sd is None else f" (u = {sd:.2g})")


def warnings(fit: "FitResult") -> tuple[str, ...]:
    """Return reasons not to take the numbers as they are, a sentence each."""
    sentences = []
    for one in fit.parameters:
        if one.verdict == "not identified":
            bound = "; the estimate is at its bound" if one.key in fit.keys_at_bound else ""
            sentences.append(f"{one.key} is not identified: {one.direction}{bound}")
        elif one.verdict == "at bound" and one.key not in fit.keys_at_bound:
            sentences.append(f"the readings give {one.key} only a limit on one side")
        elif one.verdict == "at bound":
            sentences.append(
                f"{one.key} = {one.estimate:g} is at its bound; its interval has one limit only"
            )
    if fit.flagged:
        sentences.append(
            f"the model does not fit: chi2 = {fit.tested_chi2[0]:.4g} of "
            f"{fit.tested_chi2[1]:.4g} degrees of freedom (p = {fit.p_value:.1g}); the noise is "
            "larger than its sd, or the wear law is another"
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
            sentences.append(
                "the best start has not converged: these numbers are where its search ended"
            )
        failed = [one for one in fit.starts if one.error]
        if failed:
            sentences.append(f"{len(failed)} of {len(fit.starts)} starts failed: {failed[0].error}")
    sentences += [
        f"{key}: time steps half as long would move it by {fit.discretisation_shift_sd[key]:.2g} sd"
        for key in fit.step_dependent_keys
    ]
    sentences += [
        f"{key}: an end of its likelihood-profile interval is approximate or missing: the laws do "
        "not allow values there, or histories could not be computed"
        for key in fit.inexact_limits
    ]
    if fit.posterior is not None and fit.posterior.few:
        sentences.append(
            f"the posterior's samples are worth only {fit.posterior.effective:.0f} independent "
            "ones: increase fit.samples"
        )
    return (*sentences, *_assumptions(fit))


def _assumptions(fit: "FitResult") -> list[str]:
    """Return the sentences about columns whose unit nobody names."""
    return [
        f"{series.name} ({experiment.name}): {sentence}"
        for experiment, series, _ in fit.misfit.records
        for sentence in series.assumptions
    ]


def _outliers(fit: "FitResult") -> list[str]:
    """Return which few readings do not fit at all, a sentence a series."""
    sentences = []
    misfit = fit.misfit
    for experiment, series, part in misfit.records:
        far = np.abs(fit.evaluation.noise[part])
        few = np.argsort(-far)[: max(1, int(_SHARE * series.n))]
        worst = few[far[few] > _FAR]
        if series.sd_fitted or not len(worst):
            continue
        name, share = f"{series.name} ({experiment.name})", far[worst] @ far[worst] / (far @ far)
        if share < 0.5 and np.count_nonzero(far > _FAR) > len(worst):
            continue  # most of them are off
        if series.n == 1:
            sentences.append(f"{name}: is {far[0]:.3g} sd off the model; check its unit")
            continue
        listed = worst[:_LISTED]
        axis, unit = ("r", "mm") if series.profile else ("time", "s")
        at = ", ".join(f"{series.x[i]:.6g}" for i in np.sort(listed))
        more = "" if len(worst) <= _LISTED else f" and {len(worst) - _LISTED} more"
        stop = "; if they belong to an edge or a stop, exclude leaves them out"
        hint = stop if share > 0.5 else ""
        sentences.append(
            f"{name}: {counted(len(worst), 'reading')} at {axis} = {at} {unit}{more}, up to "
            f"{far.max():.3g} sd off the model, make {100.0 * share:.3g} % of its chi2{hint}"
        )
    return sentences


def summary(fit: "FitResult") -> str:
    """Return the outcome in a few lines: the estimates, what speaks against them, the rest."""
    problem, outcome = fit.misfit.problem, fit.to_dict()
    lines = [
        f"{problem.name}: {counted(fit.n, 'reading')} in "
        f"{counted(len(problem.experiments), 'experiment')}, "
        f"{counted(len(fit.parameters), 'parameter')}, {fit.histories} histories"
        + (f" ({fit.histories_of_profiles} for profiles)" if fit.profiles else ""),
        *_parameter_lines(outcome),
        *(f"  {line}" for line in process_lines(outcome)),
    ]
    if not problem.scatters:
        lines.append(f"  intervals {of_specimens(outcome)}")
    if fit.posterior is not None:
        lines += _posterior_lines(fit, fit.posterior, outcome)
    lines += warning_lines(fit.warnings)
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
        where = "at this optimum" if converged else "at this point"
        lines.append(f"{fit.n_at_best} of {counted(len(fit.starts), 'start')} end {where}")
    if fit.alternatives or fit.failed:
        lines += _law_lines(outcome)
    if shifts := fit.discretisation_shift_sd:
        most = max(shifts, key=lambda key: abs(shifts[key]))
        lines.append(f"time steps half as long would move {most} by {shifts[most]:.2g} sd")
    return "\n".join(lines)


def of_specimens(outcome: Outcome) -> str:
    """Return the sentence that says what intervals without scatter are of."""
    count = outcome["specimens"]
    specimens = "this specimen" if count == 1 else f"these {count} specimens"
    return (
        f"of {specimens} only: repeats of a material scatter more "
        '(with repeats, use scatter = "fit")'
    )


def prediction(fit: "FitResult") -> str:
    """Return the summary of a fit whose optimum is the start, with nothing fitted."""
    problem = fit.misfit.problem
    lines = [
        f"{problem.name}: {counted(fit.n, 'reading')} in "
        f"{counted(len(problem.experiments), 'experiment')}; to be expected if the parameters have "
        "their start values (nothing written):"
    ]
    lines += warning_lines(_assumptions(fit))
    outcome = fit.to_dict()
    lines += _parameter_lines(outcome)
    lines += [f"  {line}" for line in process_lines(outcome)]
    lines += [f"  {line}" for line in known_sizes(problem, outcome["specimens"])]
    for one in fit.parameters:
        if one.direction:
            lines.append(f"  {one.key} would not be identified: {one.direction}")
    lines += _unit_lines(fit)
    lines += _correlation_lines(fit)
    settings = problem.settings
    lines.append(
        f"planned: {settings.starts} starts by {settings.method}, intervals: "
        f"{', '.join(settings.intervals)}"
    )
    if missing := settings.missing_package:
        lines.append(f"missing: {missing}")
    if problem.alternatives:
        lines.append(f"to be compared: {', '.join(problem.alternatives)}")
    return "\n".join(lines)


def _parameter_lines(outcome: Mapping[str, Any]) -> list[str]:
    level, parameters = outcome["level"], outcome["parameters"]
    width, lines = max(map(len, parameters)), []
    for key, estimate in parameters.items():
        text = f"{estimate['estimate']:.5g}{unit_suffix(estimate['unit'])}"
        if estimate["of"] == "material":
            text += " of the material"
        by = ", likelihood profile" * (estimate["interval_of"] == "likelihood profile")
        if estimate["verdict"] != "not identified":
            text += f"  {limits(estimate['interval'])} ({100 * level:g} %{by})"
        lines.append(f"  {key.ljust(width)}  {text}  {estimate['verdict']}")
        lines += [f"  {' ' * width}  {line}" for line in unit_lines(estimate)]
        lines += [f"    {line}" for line in scatter_lines(estimate, level)]
    return lines


def limits(interval: Sequence[float | None], digits: int = 5) -> str:
    """Return an interval in words."""
    low, high = interval
    if low is not None and high is not None:
        return f"from {low:.{digits}g} to {high:.{digits}g}"
    if low is None and high is None:
        return "no limit within its bounds"
    return f"more than {low:.{digits}g}" if high is None else f"less than {high:.{digits}g}"


def unit_lines(estimate: Mapping[str, Any]) -> list[str]:
    """Return a key in the unit that the user writes, and as a specific wear rate; none without.

    Parameters
    ----------
    estimate : as in fit.json.
    """
    lines, identified = [], estimate["verdict"] != "not identified"
    if (converted := estimate.get("told")) is not None:
        per = f" per {converted['per']}" if "per" in converted else ""
        lines.append(f"= {converted['estimate']:.5g} {converted['unit']}{per}")
        if identified:
            lines[-1] += f"  {limits(converted['interval'])}"
        if converted["next"] is not None:
            lines[-1] += f"; the next specimen: {limits(converted['next'])}"
    if identified and (rate := estimate.get("specific_wear_rate")) is not None:
        product = f"k mu at mu = {rate['mu']:.4g}" if "mu" in rate else "k"
        ends = "" if rate["interval"] == [None, None] else f"  {limits(rate['interval'])}"
        lines.append(
            f"specific wear rate {rate['estimate']:.4g} {rate['unit']}{ends}; "
            f"{rate[CUSTOMARY]:.4g} {CUSTOMARY} ({product})"
        )
    return lines


def scatter_lines(estimate: Mapping[str, Any], level: float) -> list[str]:
    """Return sentences about the scatter of a key, none without; ``estimate`` as in fit.json."""
    if estimate["of"] != "material":
        return []
    log, unit = "mean" in estimate, unit_suffix(estimate["unit"])

    def size(value: float) -> str:
        return f"{100.0 * value:.2g}" if log else f"{value:.3g}"

    unit_of_size = " %" if log else unit
    sizes = []
    for group, scatter in estimate["scatter"].items():
        count = scatter["groups"]
        between = f"between {count} {PLURALS[group] if count > 1 else group} "
        if "known" in scatter:
            sizes.append(f"{between}{size(scatter['known'])}{unit_of_size} (taken as known)")
            continue
        low, high = scatter["interval"]
        at_bound = ", perhaps none" * (scatter["verdict"] == "at bound")
        sizes.append(
            f"{between}{size(scatter['estimate'])}{unit_of_size} ({size(low)} to "
            f"{size(high)}{unit_of_size}{at_bound})"
        )
    low, high = estimate["next"]
    lines = [f"{'; '.join(sizes)}", f"the next specimen: from {low:.4g} to {high:.4g}{unit}"]
    limits = [
        f"{name} {symbol} = {size(estimate[name][symbol])}{unit_of_size}"
        for name, symbol in (("repeatability", "r"), ("reproducibility", "R"))
        if name in estimate
    ]
    if limits:
        lines[-1] += f" ({100.0 * level:g} %); {', '.join(limits)}"
    if (needed := estimate.get("specimens_for_10_percent")) is not None:
        lines.append(
            f"an interval of +-10 % for the material needs about {counted(needed, 'specimen')}"
        )
    return lines


def process_lines(outcome: Outcome) -> list[str]:
    """Return a sentence about each body whose wear is itself random, and what follows of it."""
    lines = []
    for key, entry in outcome.get("process", {}).items():
        size, share = entry["size"], entry["share"]
        known = "known" in share
        sd = share["known" if known else "estimate"]
        events = size["known" if known else "estimate"]
        text = (
            f"wear of {body_of_wear(key)} fluctuates: sd {100.0 * sd:.2g} % of the "
            f"{1e3 * entry['depth']:.3g} um worn at the end"
        )
        if (ends := share.get("interval")) is not None:
            low, high = (100.0 * end for end in ends)
            text += f" ({100.0 * outcome['level']:g} %: {low:.2g} to {high:.2g} %)"
        text += f"; events of {1e6 * events:.3g} nm"
        if (ends := size.get("interval")) is not None:
            low, high = (1e6 * end for end in ends)
            text += f" ({low:.3g} to {high:.3g} nm)"
        lines.append(f"{text} (taken as known)" if known else f"{text}  {entry['verdict']}")
    scatters = [
        scatter
        for estimate in outcome["parameters"].values()
        for scatter in estimate.get("scatter", {}).values()
    ]
    if lines and any(scatter.get("verdict") == "at bound" for scatter in scatters):
        lines.append(
            "beside it, the specimens may not differ at all: with 3 specimens or more, scatter "
            "alone is enough for values of the material"
        )
    return lines


def _posterior_lines(
    fit: "FitResult", posterior: "Posterior", outcome: Mapping[str, Any]
) -> list[str]:
    parameters, level = outcome["parameters"], outcome["level"]
    width = max(map(len, parameters))
    lines = [
        f"posterior: {len(posterior.samples)} samples worth {posterior.effective:.0f} independent "
        "ones, "
        f"{100.0 * posterior.acceptance:.0f} % of the moves accepted"
        + ("; fitted noise stays at its best value" if fit.noise_fitted else "")
    ]
    for key, estimate in parameters.items():
        sampled = estimate["posterior"]
        low, high = sampled["interval"]
        lines.append(
            f"  {key.ljust(width)}  {sampled['median']:.5g}{unit_suffix(estimate['unit'])}  "
            f"from {low:.5g} to {high:.5g} ({100 * level:g} %)"
        )
    return lines


def _unit_lines(fit: "FitResult") -> list[str]:
    lines = []
    for experiment, series, _ in fit.misfit.records:
        spread = np.median(series.sd) / series.factor
        lines.append(
            f"  {experiment.name}, {series.name}: {counted(series.n, 'reading')} in {series.unit}, "
            "noise "
            f"{spread:.3g}{' (guessed, to be fitted)' if series.sd_fitted else ''}"
        )
    return lines


def _correlation_lines(fit: "FitResult") -> list[str]:
    strong = [pair for pair in fit.correlations() if abs(pair[2]) > _STRONG]
    return [
        f"correlation {value:+.3f} between {one} and {other}" for one, other, value in strong[:5]
    ]


def _law_lines(outcome: Mapping[str, Any]) -> list[str]:
    rows = law_rows(outcome)
    lines = ["laws compared (AIC above the smallest, BIC, chi2, probability, parameters):"]
    for row in rows:
        if row.aic_difference is None:
            lines.append(f"  {row.name}: {row.verdict}")
            continue
        flag = "; does not fit" * (row.verdict == "does not fit")
        share = "-" if row.probability is None else f"{row.probability:.2g}"
        lines.append(
            f"  {row.name}: {row.aic_difference:+.1f}, {row.bic:.5g}, {row.chi2:.5g}, {share}; "
            f"{row.parameters}{flag}"
        )
    if all(row.aic_difference is None or row.verdict == "does not fit" for row in rows):
        lines.append("  none of them fits")
    return lines
