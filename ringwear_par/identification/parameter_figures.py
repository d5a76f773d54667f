"""The figure of the fitted keys: a panel each, and one for each pair of them."""

import math
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi2, norm

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.units import in_signs
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.estimation.intervals import ParameterEstimate
from ringwear_par.identification.outcome import FitResult
from ringwear_par.identification.summary import unit_of
from ringwear_par.pictures.style import COLOURS, NotebookFigure

_LINEAR, _PROFILE, _SAMPLES, _BEST = COLOURS[0], COLOURS[2], "0.6", COLOURS[1]
_LEVELS = (0.68, 0.95)


def parameter_figure(found: FitResult) -> Figure:
    """Return densities by key on the diagonal, pairs with confidence ellipses below it."""
    m = len(found.parameters)
    chart = NotebookFigure(figsize=(1.2 + 2.7 * m, 0.9 + 2.5 * m), layout="constrained")
    panels = chart.subplots(m, m, squeeze=False)
    for row in range(m):
        for column in range(m):
            axes = panels[row, column]
            if column > row:
                axes.set_axis_off()
                continue
            if row == column:
                _draw_one(axes, found, row)
            else:
                _draw_pair(axes, found, column, row)
            limits = _limits(found, column)
            if limits is not None:
                axes.set_xlim(limits)
            if row != column and (limits := _limits(found, row)) is not None:
                axes.set_ylim(limits)
            axes.tick_params(labelsize=7)
            axes.locator_params(nbins=4)
            told = _told_axis(axes.xaxis, found.parameters[column], found.squares.problem)
            if row == m - 1:
                axes.set_xlabel(told, fontsize=8)
            else:
                axes.tick_params(labelbottom=False)
            if row != column:
                told = _told_axis(axes.yaxis, found.parameters[row], found.squares.problem)
                if column == 0:
                    axes.set_ylabel(told, fontsize=8)
                else:
                    axes.tick_params(labelleft=False)
    handles: dict[str, Any] = {}
    for axes in panels.ravel():
        handles |= {label: h for h, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    chart.legend(handles.values(), handles.keys(), loc="outside upper center",
                 ncols=2 if m == 1 else 4, fontsize=7, frameon=False)  # fmt: skip
    return chart


def _told_axis(axis: Any, one: ParameterEstimate, problem: Problem) -> str:
    """Return what an axis of a key is called, with the power of ten that its ticks leave out."""
    power = math.floor(math.log10(max(np.abs(axis.get_view_interval()))))
    if -3 <= power < 4:
        power = 0
    axis.set_major_formatter(lambda value, _: f"{value / 10.0**power:.6g}")
    parts = [f"$10^{{{power}}}$" if power else "", in_signs(unit_of(problem, one.key).strip())]
    unit = " ".join(part for part in parts if part)
    return f"{one.key} ({unit})" if unit else one.key


def _sd(found: FitResult, j: int) -> float:
    """Return the standard deviation of an unknown, infinite where it is not told."""
    return float(found.standard_deviations[j])


def _limits(found: FitResult, j: int) -> tuple[float, float] | None:
    """Return what of an axis is shown: four sd, or the whole of the samples."""
    parameter, one = found.squares.problem.parameters[j], found.parameters[j]
    ends = [one.estimate]
    if one.verdict != "not identified" and np.isfinite(sd := _sd(found, j)):
        ends += [parameter.value(found.x[j] - 4.0 * sd), parameter.value(found.x[j] + 4.0 * sd)]
    if found.posterior is not None:
        ends += np.quantile(found.posterior.samples[:, j], [0.001, 0.999]).tolist()
    low, high = min(ends), max(ends)
    return (low, high) if low < high else None


def _draw_one(axes: Any, found: FitResult, j: int) -> None:
    """Draw likelihoods over a key, relative to the best fit's."""
    parameter, one = found.squares.problem.parameters[j], found.parameters[j]
    level = found.squares.problem.settings.level
    if one.verdict == "not identified":
        axes.text(
            0.5, 0.9, one.verdict, transform=axes.transAxes, ha="center", fontsize=8,
            bbox={"color": "white", "alpha": 0.8},
        )  # fmt: skip
    elif np.isfinite(sd := _sd(found, j)):
        shift = np.linspace(-4.0, 4.0, 161)
        values = [parameter.value(found.x[j] + sd * s) for s in shift.tolist()]
        axes.plot(values, np.exp(-0.5 * shift**2), color=_LINEAR, label="linear")
    if found.posterior is not None:
        samples = found.posterior.samples[:, j]
        # more bins than so many independent samples fill show but their scatter
        bins = max(math.ceil(2.0 * found.posterior.effective ** (1.0 / 3.0)), 5)
        heights, edges = np.histogram(samples, bins=bins, density=True)
        # of a normal distribution the largest density is 1 / (sd sqrt(2 pi))
        heights *= np.sqrt(2.0 * np.pi) * samples.std()
        axes.stairs(heights, edges, fill=True, color=_SAMPLES, alpha=0.5,
                    label="posterior")  # fmt: skip
    if one.key in found.profiles:
        _draw_profile(axes, found.profiles[one.key], one.estimate)
    if found.squares.problem.settings.loss == "gaussian" and one.verdict != "not identified":
        half = float(norm.ppf(level if one.verdict == "at bound" else 0.5 + 0.5 * level))
        axes.axhline(
            np.exp(-0.5 * half * half), color="0.5", lw=0.8, ls=":", zorder=0,
            label=f"likelihood at {100 * level:g} % limits",
        )  # fmt: skip
    for end in one.interval:
        if end is not None:
            axes.axvline(end, color="0.5", lw=0.8, ls="--", label=f"{100 * level:g} % interval")
    axes.axvline(one.estimate, color=_BEST, lw=1, label="best fit")
    axes.set_ylim(0.0, None)
    axes.set_ylabel("relative likelihood", fontsize=8)


def _draw_profile(axes: Any, profile: FloatArray, estimate: float) -> None:
    """Draw a likelihood profile; the root of its growth is nearly linear between its points."""
    values, growth = profile
    axes.plot(values, np.exp(-0.5 * growth), "o", color=_PROFILE, ms=3)
    between = np.linspace(values[0], values[-1], 161)
    roots = np.interp(between, values, np.sign(values - estimate) * np.sqrt(growth))
    axes.plot(between, np.exp(-0.5 * roots**2), color=_PROFILE, lw=0.8)
    axes.plot([], [], "o-", color=_PROFILE, ms=3, lw=0.8, label="likelihood profile")


def _draw_pair(axes: Any, found: FitResult, i: int, j: int) -> None:
    """Draw ellipses of two keys, and their samples."""
    if found.posterior is not None:
        samples = found.posterior.samples[:, [i, j]].T
        axes.plot(*samples, ".", color=_SAMPLES, ms=1.5, alpha=0.5, rasterized=True)
    unknown = [one for one in (found.parameters[i], found.parameters[j])
               if one.verdict != "identified"]  # fmt: skip
    if unknown:
        told = "\n".join(f"{one.key}: {one.verdict}" for one in unknown)
        axes.text(0.5, 0.95, told, transform=axes.transAxes, ha="center", va="top", fontsize=7)
    else:
        covariance = found.covariance[np.ix_([i, j], [i, j])]
        for level, style in zip(_LEVELS, ("-", "--"), strict=True):
            shown = _ellipse(found, i, j, covariance, level)
            axes.plot(*shown, style, color=_LINEAR, label=f"{100 * level:g} % ellipse")
    best = [found.parameters[k].estimate for k in (i, j)]
    axes.plot(*best, "+", color=_BEST, ms=9, mew=1.5)


def _ellipse(
    found: FitResult, i: int, j: int, covariance: FloatArray, level: float
) -> tuple[list[float], list[float]]:
    values, vectors = np.linalg.eigh(covariance)
    radius = np.sqrt(np.maximum(values, 0.0) * chi2.ppf(level, 2))
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    x, y = vectors @ (radius[:, None] * np.stack([np.cos(angle), np.sin(angle)]))
    one, other = (found.squares.problem.parameters[k] for k in (i, j))
    return (
        [one.value(found.x[i] + s) for s in x.tolist()],
        [other.value(found.x[j] + s) for s in y.tolist()],
    )
