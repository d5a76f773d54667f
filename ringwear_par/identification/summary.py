"""A fit in a few lines of text, and what to expect of one before its readings are there."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.errors import warning_lines
from ringwear_par.identification.fit_doubts import assumptions
from ringwear_par.identification.fit_rows import (
    KeyRow,
    counted,
    goodness,
    input_lines,
    key_rows,
    law_rows,
    limits,
    of_specimens,
    process_lines,
    scatter_lines,
    series_rows,
)
from ringwear_par.identification.scatter.material import known_sizes

if TYPE_CHECKING:
    from ringwear_par.identification.fit_result import FitResult

#: correlations that are listed, and how many at most
_STRONG, _LISTED = 0.9, 5


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
        lines.append(
            f"posterior: {len(fit.posterior.samples)} samples worth {fit.posterior.effective:.0f} "
            f"independent ones, {100.0 * fit.posterior.acceptance:.0f} % of the moves accepted"
            + ("; fitted noise stays at its best value" if fit.noise_fitted else "")
        )
    lines += warning_lines(doubt.text for doubt in fit.doubts)
    lines.append(goodness(outcome))
    for name, n, chi2, unit, noise, notes in series_rows(outcome):
        words = [
            counted(int(n), "reading"),
            chi2 and f"chi2 {chi2}",
            noise and f"noise {noise} {unit}",
        ]
        lines.append(f"  {name}: {', '.join(filter(None, [*words, notes]))}")
    lines += [f"  {line}" for line in input_lines(outcome)]
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


def prediction(fit: "FitResult") -> str:
    """Return the summary of a fit whose optimum is the start, with nothing fitted."""
    problem = fit.misfit.problem
    lines = [
        f"{problem.name}: {counted(fit.n, 'reading')} in "
        f"{counted(len(problem.experiments), 'experiment')}; to be expected if the parameters have "
        "their start values (nothing written):"
    ]
    lines += warning_lines(doubt.text for doubt in assumptions(fit))
    outcome = fit.to_dict()
    lines += _parameter_lines(outcome)
    lines += [f"  {line}" for line in process_lines(outcome)]
    lines += [f"  {line}" for line in known_sizes(problem, outcome["specimens"])]
    for one in fit.parameters:
        if one.direction:
            lines.append(f"  {one.key} would not be identified: {one.direction}")
    lines += _unit_lines(fit)
    lines += [f"  {line}" for line in input_lines(outcome)]
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
    for key, entry in parameters.items():
        by = ", likelihood profile" * (entry["interval_of"] == "likelihood profile")
        of = " of the material" * (entry["of"] == "material")
        row, *derived = key_rows(key, entry)
        text = _row_text(row, 5)
        if of or row.verdict != "not identified":
            interval = "" if row.estimate is None else f"  {limits(row.interval)}"
            text = f"{text}{of}{interval} ({100 * level:g} %{by})"
        lines.append(f"  {key.ljust(width)}  {text}  {row.verdict}")
        if row.posterior:
            median, *ends = row.posterior
            text = f"{median:.5g} {row.unit}".rstrip()
            lines.append(f"  {' ' * width}  {text}  {limits(ends)} (posterior)")
        for other in derived:
            known = f"  {limits(other.interval)}" if other.interval != [None, None] else ""
            text = f"{other.label} {_row_text(other, 4)}{known} ({other.note})"
            lines.append(f"  {' ' * width}  {text}")
        lines += [f"    {line}" for line in scatter_lines(entry, level)]
    return lines


def _row_text(row: KeyRow, digits: int) -> str:
    number = limits(row.interval) if row.estimate is None else f"{row.estimate:.{digits}g}"
    return f"{number} {row.unit}".rstrip()


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
        f"correlation {value:+.3f} between {one} and {other}"
        for one, other, value in strong[:_LISTED]
    ]


def _law_lines(outcome: Mapping[str, Any]) -> list[str]:
    rows = law_rows(outcome)
    lines = ["laws compared (AIC above the smallest, BIC, chi2, probability, parameters):"]
    for name, *numbers, parameters, verdict in rows:
        flag = "; does not fit" * (verdict == "does not fit")
        text = f"{', '.join(numbers)}; {parameters}{flag}" if parameters else verdict
        lines.append(f"  {name}: {text}")
    if all(row[-1] == "does not fit" or not row[1] for row in rows):
        lines.append("  none of them fits")
    return lines
