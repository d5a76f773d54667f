"""The figure of the fitted keys: a panel each, and one for each pair of them."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi2, norm

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.intervals import ParameterEstimate
from ringwear_par.identification.summary import unit_of

if TYPE_CHECKING:
    from ringwear_par.identification.outcome import FitResult

_LINEAR, _PROFILE, _SAMPLES, _BEST = "C0", "C1", "0.6", "C3"
_LEVELS = (0.68, 0.95)


def figure(found: "FitResult") -> Figure:
    """Return densities by key on the diagonal, pairs with confidence ellipses below it."""
    m = len(found.parameters)
    chart = Figure(figsize=(1.2 + 2.7 * m, 0.9 + 2.5 * m), layout="constrained")
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
            for axis in (axes.xaxis, axes.yaxis):
                axis.get_offset_text().set_fontsize(7)
            axes.locator_params(nbins=4)
            if row == m - 1:
                axes.set_xlabel(_label(found.parameters[column]), fontsize=8)
            else:
                axes.tick_params(labelbottom=False)
            if row != column and column == 0:
                axes.set_ylabel(_label(found.parameters[row]), fontsize=8)
    handles: dict[str, Any] = {}
    for axes in panels.ravel():
        handles |= {label: h for h, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    chart.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=2, fontsize=7,
                 frameon=False)  # fmt: skip
    return chart


def _label(one: ParameterEstimate) -> str:
    unit = unit_of(one.key).strip()
    return f"{one.key} ({unit})" if unit else one.key


def _sd(found: "FitResult", j: int) -> float:
    """Return the standard deviation of an unknown, infinite where it is not told."""
    return float(found.standard_deviations[j])


def _limits(found: "FitResult", j: int) -> tuple[float, float] | None:
    """Return what of an axis is shown: four sd, or the whole of the samples."""
    parameter = found.squares.problem.parameters[j]
    ends = []
    if np.isfinite(sd := _sd(found, j)):
        ends += [parameter.value(found.x[j] - 4.0 * sd), parameter.value(found.x[j] + 4.0 * sd)]
    if found.posterior is not None:
        ends += np.quantile(found.posterior.samples[:, j], [0.001, 0.999]).tolist()
    if not ends:
        return None
    return min(ends), max(ends)


def _draw_one(axes: Any, found: "FitResult", j: int) -> None:
    """Draw likelihoods over a key, relative to the best fit's."""
    parameter, one = found.squares.problem.parameters[j], found.parameters[j]
    if np.isfinite(sd := _sd(found, j)):
        shift = np.linspace(-4.0, 4.0, 161)
        values = [parameter.value(found.x[j] + sd * s) for s in shift.tolist()]
        axes.plot(values, np.exp(-0.5 * shift**2), color=_LINEAR, label="linear")
    if found.posterior is not None:
        samples = found.posterior.samples[:, j]
        heights, edges = np.histogram(samples, bins=30, density=True)
        # of a normal distribution the largest density is 1 / (sd sqrt(2 pi))
        heights *= np.sqrt(2.0 * np.pi) * samples.std()
        axes.stairs(heights, edges, fill=True, color=_SAMPLES, alpha=0.5,
                    label="posterior")  # fmt: skip
    if one.key in found.profiles:
        values, growth = found.profiles[one.key]
        axes.plot(
            values, np.exp(-0.5 * growth), "o", color=_PROFILE, ms=3, label="likelihood profile"
        )
    if found.squares.problem.settings.loss == "gaussian":
        level = found.squares.problem.settings.level
        half = float(norm.ppf(0.5 + 0.5 * level))
        axes.axhline(np.exp(-0.5 * half * half), color="0.8", lw=0.8, zorder=0)
    for end in one.interval:
        if end is not None:
            axes.axvline(end, color="0.5", lw=0.8, ls="--")
    axes.axvline(one.estimate, color=_BEST, lw=1, label="best fit")
    axes.set_ylim(0.0, None)
    axes.set_ylabel("relative likelihood", fontsize=8)


def _draw_pair(axes: Any, found: "FitResult", i: int, j: int) -> None:
    """Draw ellipses of two keys, and their samples."""
    if found.posterior is not None:
        samples = found.posterior.samples[:, [i, j]].T
        axes.plot(*samples, ".", color=_SAMPLES, ms=1.5, alpha=0.5, rasterized=True)
    covariance = found.covariance[np.ix_([i, j], [i, j])]
    if np.isfinite(covariance).all():
        for level, style in zip(_LEVELS, ("-", "--"), strict=True):
            shown = _ellipse(found, i, j, covariance, level)
            axes.plot(*shown, style, color=_LINEAR, label=f"{100 * level:g} % ellipse")
    best = [found.parameters[k].estimate for k in (i, j)]
    axes.plot(*best, "+", color=_BEST, ms=9, mew=1.5)


def _ellipse(
    found: "FitResult", i: int, j: int, covariance: FloatArray, level: float
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
