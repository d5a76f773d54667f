"""The figure of a fit: data and model of every series with its band, and the residuals below.

Series of one reading, such as weighings, share a strip below: a line each.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi2, norm

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.units import in_signs
from ringwear_par.errors import InputError
from ringwear_par.identification.definition.fitted_parameters import unit_of_key
from ringwear_par.identification.definition.problem import Experiment, Problem, Series
from ringwear_par.identification.estimation.intervals import ParameterEstimate
from ringwear_par.identification.fit_result import FitResult
from ringwear_par.pictures import fits
from ringwear_par.pictures.matplotlib import draw
from ringwear_par.pictures.panels import GREY
from ringwear_par.pictures.style import COLOURS, NotebookFigure

_COLUMNS = 3
_WIDTH, _HEIGHT = 4.3, 3.9
#: of the strip of single readings: a line of it, what is around them, and how narrow it may be
_ROW, _MARGIN, _NARROWEST = 0.28, 0.55, 6.5
#: what readings are called, by the first part of their quantity, if not by that
_WORDS = {"profile": "depth", "mass": "mass loss", "volume": "volume loss"}
#: size of letters
_TITLE, _SMALL = 8, 7
_LINEAR, _PROFILE, _SAMPLES, _BEST = COLOURS[0], COLOURS[2], "0.6", COLOURS[1]
_LEVELS = (0.68, 0.95)


def figure(fit: FitResult) -> Figure:
    """Return the figure of data, model, its band at the fit's level, and residuals."""
    misfit = fit.misfit
    all_series = [
        _series(fit, experiment, series, part) for experiment, series, part in misfit.records
    ]
    curves = [series for series in all_series if len(series.x) > 1]
    single = [series for series in all_series if len(series.x) == 1]
    across = 2 if len(curves) == 4 else min(_COLUMNS, max(len(curves), 1))
    down = math.ceil(len(curves) / across)
    heights = _HEIGHT * down, _MARGIN + _ROW * len(single)
    width = max(_WIDTH * across, _NARROWEST if single else 0.0)
    chart = NotebookFigure(
        figsize=(width, heights[0] + bool(single) * heights[1]), layout="constrained"
    )
    parts: Any = chart, chart
    if single and curves:  # labels of the strip make no panel above it narrower
        parts = chart.subfigures(2, 1, height_ratios=heights)
    top, strip = parts
    grid = top.add_gridspec(max(2 * down, 1), across, height_ratios=[5, 2] * down or [1])
    for place, series in enumerate(curves):
        row, column = divmod(place, across)
        above = top.add_subplot(grid[2 * row, column])
        below = top.add_subplot(grid[2 * row + 1, column], sharex=above)
        _draw(above, below, series)
        if place == 0:
            above.legend(fontsize=_SMALL, frameon=False)
    if single:
        _draw_single(strip.add_subplot(), single, explained=not curves)
    return chart


def _series(fit: FitResult, experiment: Experiment, series: Series, part: slice) -> fits.Series:
    """Return a series with its model, in the unit of its readings."""
    scale, misfit = 1.0 / series.factor, fit.misfit
    return fits.Series(
        experiment.name, series.name, in_signs(series.unit), series.x, series.profile,
        scale * series.value, scale * fit.evaluation.model[part], scale * misfit.sd[part],
        scale * fit.band[part], -fit.evaluation.noise[part], misfit.problem.settings.level,
        label(series), experiment.case.contact,
    )  # fmt: skip


def label(series: Series) -> str:
    """Return the label of an axis of readings."""
    kind, _, body = series.quantity.partition(".")
    of = f" of {body}" if body else ""
    return f"{_WORDS.get(kind, kind)}{of} ({in_signs(series.unit)})"


def _draw(above: Any, below: Any, series: fits.Series) -> None:
    """Draw readings and model, and the residuals below them."""
    draw(above, fits.readings(series), 0)
    draw(below, fits.residuals(series), 0)
    # ticks that change with the height of a panel would leave no room for its label
    tick = math.floor(0.75 * below.get_ylim()[1])
    below.set_yticks([-tick, 0, tick])
    for axes in (above, below):
        axes.tick_params(labelsize=_SMALL)
    above.tick_params(labelbottom=False)
    above.set_title(series.title, fontsize=_TITLE)
    above.set_xlabel("")
    above.yaxis.label.set_size(_TITLE)
    below.xaxis.label.set_size(_TITLE)
    below.yaxis.label.set_size(_SMALL)


def _draw_single(axes: Any, single: Sequence[fits.Series], *, explained: bool) -> None:
    """Draw series of one reading, a line each: how far it is off the model, and both in words."""
    level, quantile = f"{100 * single[0].level:g} %", single[0].quantile
    residuals, bands = (
        np.array([values(series)[0] for series in single])
        for values in (lambda series: series.residuals, lambda series: series.band / series.sd)
    )
    places, words = np.arange(len(single)), []
    for values, colour, shade, whose in (
        (np.hypot(bands, 1.0), COLOURS[0], 0.15, "of readings"),
        (bands, COLOURS[1], 0.35, "of the model"),
    ):  # fmt: skip
        axes.barh(
            places, 2 * quantile * values, left=-quantile * values, height=0.7, color=colour,
            alpha=shade, lw=0, label=f"{level} {whose}",
        )  # fmt: skip
    axes.axvline(0.0, color=COLOURS[1], lw=1, label="model")
    axes.plot(residuals, places, "o", color=GREY, ms=4, label="data")
    for series in single:
        value, sd = series.data[0], quantile * series.sd[0]
        model, band = series.model[0], quantile * series.band[0]
        words.append(
            f"{value:.4g} \N{PLUS-MINUS SIGN} {sd:.2g} {series.unit}, "
            f"model {model:.4g} \N{PLUS-MINUS SIGN} {band:.2g}"
        )
    reach = max(4.0, 1.1 * float(np.abs(residuals).max()), 1.1 * quantile * float(bands.max()))
    axes.set_xlim(-reach, reach)
    axes.set_ylim(len(single) - 0.4, -0.6)
    axes.set_yticks(places, [series.title for series in single])
    right = axes.secondary_yaxis("right")
    right.set_yticks(places, words)
    for side in (axes, right):
        side.tick_params(labelsize=_SMALL)
    right.tick_params(length=0)
    axes.set_xlabel(fits.RESIDUAL, fontsize=_SMALL)
    if explained:
        axes.legend(fontsize=_SMALL, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0),
                    ncols=4)  # fmt: skip


def parameter_figure(fit: FitResult) -> Figure:
    """Return densities by key on the diagonal, pairs with confidence ellipses below it."""
    m = len(fit.parameters)
    chart = NotebookFigure(figsize=(1.2 + 2.7 * m, 0.9 + 2.5 * m), layout="constrained")
    panels = chart.subplots(m, m, squeeze=False)
    for row in range(m):
        for column in range(m):
            axes = panels[row, column]
            if column > row:
                axes.set_axis_off()
                continue
            if row == column:
                _draw_one(axes, fit, row)
            else:
                _draw_pair(axes, fit, column, row)
            limits = _limits(fit, column)
            if limits is not None:
                axes.set_xlim(limits)
            if row != column and (limits := _limits(fit, row)) is not None:
                axes.set_ylim(limits)
            axes.tick_params(labelsize=7)
            axes.locator_params(nbins=4)
            label = _label_axis(axes.xaxis, fit.parameters[column], fit.misfit.problem)
            if row == m - 1:
                axes.set_xlabel(label, fontsize=8)
            else:
                axes.tick_params(labelbottom=False)
            if row != column:
                label = _label_axis(axes.yaxis, fit.parameters[row], fit.misfit.problem)
                if column == 0:
                    axes.set_ylabel(label, fontsize=8)
                else:
                    axes.tick_params(labelleft=False)
    handles: dict[str, Any] = {}
    for axes in panels.ravel():
        handles |= {label: h for h, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    chart.legend(handles.values(), handles.keys(), loc="outside upper center",
                 ncols=2 if m == 1 else 4, fontsize=7, frameon=False)  # fmt: skip
    return chart


def specimen_figure(fit: FitResult) -> Figure:
    """Return the values of specimens of each key that scatters, and the material's.

    Raises
    ------
    InputError : a fit without scatter.
    """
    outcome = fit.to_dict()
    scattering = {k: one for k, one in outcome["parameters"].items() if "each" in one}
    if not scattering:
        raise InputError("plot_specimens: no key of the fit has scatter; must be a fit with one")
    widest = max(len(one["each"]) for one in scattering.values())
    size = max(_NARROWEST, 0.7 * min(widest, 16)), _HEIGHT * len(scattering)
    chart = NotebookFigure(figsize=size, layout="constrained")
    panels = chart.subplots(len(scattering), 1, squeeze=False)[:, 0]
    for axes, (key, one) in zip(panels, scattering.items(), strict=True):
        draw(axes, fits.specimens(key, one, outcome["level"]), 0)
        axes.legend(fontsize=_SMALL, frameon=False, loc="upper center",
                    bbox_to_anchor=(0.5, -0.14), ncols=3)  # fmt: skip
    return chart


def _label_axis(axis: Any, one: ParameterEstimate, problem: Problem) -> str:
    """Return the label of an axis of a key, with the power of ten that its ticks leave out."""
    power = math.floor(math.log10(max(np.abs(axis.get_view_interval()))))
    if -3 <= power < 4:
        power = 0
    axis.set_major_formatter(lambda value, _: f"{value / 10.0**power:.6g}")
    parts = [f"$10^{{{power}}}$" if power else "", in_signs(unit_of_key(problem, one.key).strip())]
    unit = " ".join(part for part in parts if part)
    return f"{one.key} ({unit})" if unit else one.key


def _sd(fit: FitResult, j: int) -> float:
    """Return the standard deviation of an unknown, infinite where the readings give none."""
    return float(fit.standard_deviations[j])


def _limits(fit: FitResult, j: int) -> tuple[float, float] | None:
    """Return the limits of an axis: four sd, or the whole of the samples."""
    parameter, one = fit.misfit.problem.parameters[j], fit.parameters[j]
    ends = [one.estimate]
    if one.verdict != "not identified" and np.isfinite(sd := _sd(fit, j)):
        ends += [parameter.value(fit.x[j] - 4.0 * sd), parameter.value(fit.x[j] + 4.0 * sd)]
    if fit.posterior is not None:
        ends += np.quantile(fit.posterior.samples[:, j], [0.001, 0.999]).tolist()
    low, high = min(ends), max(ends)
    return (low, high) if low < high else None


def _draw_one(axes: Any, fit: FitResult, j: int) -> None:
    """Draw likelihoods over a key, relative to the best fit's."""
    parameter, one = fit.misfit.problem.parameters[j], fit.parameters[j]
    level = fit.misfit.problem.settings.level
    if one.verdict == "not identified":
        axes.text(
            0.5, 0.9, one.verdict, transform=axes.transAxes, ha="center", fontsize=8,
            bbox={"color": "white", "alpha": 0.8},
        )  # fmt: skip
    elif np.isfinite(sd := _sd(fit, j)):
        shift = np.linspace(-4.0, 4.0, 161)
        values = [parameter.value(fit.x[j] + sd * s) for s in shift.tolist()]
        axes.plot(values, np.exp(-0.5 * shift**2), color=_LINEAR, label="linear")
    if fit.posterior is not None:
        samples = fit.posterior.samples[:, j]
        # more bins than so many independent samples fill show but their scatter
        bins = max(math.ceil(2.0 * fit.posterior.effective ** (1.0 / 3.0)), 5)
        heights, edges = np.histogram(samples, bins=bins, density=True)
        # of a normal distribution the largest density is 1 / (sd sqrt(2 pi))
        heights *= np.sqrt(2.0 * np.pi) * samples.std()
        axes.stairs(heights, edges, fill=True, color=_SAMPLES, alpha=0.5,
                    label="posterior")  # fmt: skip
    if one.key in fit.profiles:
        _draw_profile(axes, fit.profiles[one.key], one.estimate)
    if fit.misfit.problem.settings.loss == "gaussian" and one.verdict != "not identified":
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


def _draw_pair(axes: Any, fit: FitResult, i: int, j: int) -> None:
    """Draw ellipses of two keys, and their samples."""
    if fit.posterior is not None:
        samples = fit.posterior.samples[:, [i, j]].T
        axes.plot(*samples, ".", color=_SAMPLES, ms=1.5, alpha=0.5, rasterized=True)
    unknown = [one for one in (fit.parameters[i], fit.parameters[j])
               if one.verdict != "identified"]  # fmt: skip
    if unknown:
        verdicts = "\n".join(f"{one.key}: {one.verdict}" for one in unknown)
        axes.text(0.5, 0.95, verdicts, transform=axes.transAxes, ha="center", va="top", fontsize=7)
    else:
        covariance = fit.covariance[np.ix_([i, j], [i, j])]
        for level, style in zip(_LEVELS, ("-", "--"), strict=True):
            ellipse = _ellipse(fit, i, j, covariance, level)
            axes.plot(*ellipse, style, color=_LINEAR, label=f"{100 * level:g} % ellipse")
    best = [fit.parameters[k].estimate for k in (i, j)]
    axes.plot(*best, "+", color=_BEST, ms=9, mew=1.5)


def _ellipse(
    fit: FitResult, i: int, j: int, covariance: FloatArray, level: float
) -> tuple[list[float], list[float]]:
    values, vectors = np.linalg.eigh(covariance)
    radius = np.sqrt(np.maximum(values, 0.0) * chi2.ppf(level, 2))
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    x, y = vectors @ (radius[:, None] * np.stack([np.cos(angle), np.sin(angle)]))
    one, other = (fit.misfit.problem.parameters[k] for k in (i, j))
    return (
        [one.value(fit.x[i] + s) for s in x.tolist()],
        [other.value(fit.x[j] + s) for s in y.tolist()],
    )
