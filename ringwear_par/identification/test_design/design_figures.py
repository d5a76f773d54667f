"""The map of a test design: predicted standard deviations over loads, or over load and duration."""

from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.units import in_signs
from ringwear_par.identification.test_design.candidates import Candidate
from ringwear_par.identification.test_design.design import DesignResult
from ringwear_par.identification.test_design.design_numbers import name_of_tests, sd_scales
from ringwear_par.pictures.style import COLOURS, NotebookFigure
from ringwear_par.results.instants import time_unit

_MAP = "viridis_r"


def figure(design: DesignResult) -> Figure:
    """Return a map for each key: of two tests over their loads, of one over load and duration.

    Of two tests a cell has the durations of the best score within the budget.

    Where neither varies, bars of the best designs. Of several tests the map is that of one.
    """
    scales = sd_scales(design)
    m = len(scales)
    lines = sum(len(one.tests) for one in design.designs)
    chart = NotebookFigure(figsize=(4.6 * m, max(4.2, 0.2 * lines)), layout="constrained")
    panels = chart.subplots(1, m, squeeze=False)[0]
    plain = np.array(
        [i for i, test in enumerate(design.candidates) if _is_plain(test)], dtype=np.int64
    )
    for j, (axes, scale) in enumerate(zip(panels, scales, strict=True)):
        unit = in_signs(scale.unit)
        label = f"predicted sd of {scale.key}" + (f" ({unit})" if unit else "")
        if len(plain) and len(design.pairs):
            _map_of_pairs(
                axes, design, plain, scale.factor * design.pairs[..., j], label, first=j == 0
            )
        elif len({design.candidates[i].seconds for i in plain}) > 1:
            _map_of_tests(axes, design, plain, scale.factor * design.single[:, j], label)
        else:
            _bars(axes, design, j, scale.factor, label)
    return chart


def _is_plain(test: Candidate) -> bool:
    return len(test.loads) == 1 and len(test.profiles) <= 1 and "load.omega" not in test.keys


def _axis_of(design: DesignResult, plain: IntArray) -> tuple[str, list[float]]:
    first = design.candidates[plain[0]]
    unit = "MPa" if "load.pressure" in first.keys else "N"
    quantity = "mean pressure" if unit == "MPa" else "force"
    return f"{quantity} ({unit})", sorted({design.candidates[i].loads[0] for i in plain})


def _map_of_pairs(
    axes: Any,
    design: DesignResult,
    plain: IntArray,
    values: FloatArray,
    label: str,
    first: bool,
) -> None:
    """Draw the sd that two tests of these loads give, their durations being the best by score."""
    name, loads = _axis_of(design, plain)
    place = {load: k for k, load in enumerate(loads)}
    cells = np.array([place[design.candidates[i].loads[0]] for i in plain])
    best = np.full((len(loads), len(loads)), -np.inf)
    table = np.full_like(best, np.nan)
    part = np.ix_(plain, plain)
    for row, column in np.argwhere(np.isfinite(design.pair_scores[part])).tolist():
        cell = cells[row], cells[column]
        score = design.pair_scores[plain[row], plain[column]]
        if score > best[cell]:
            best[cell], table[cell] = score, values[plain[row], plain[column]]
    _draw(axes, loads, loads, np.where(np.isfinite(table), table, np.nan), label)
    axes.set_xlabel(f"{name} of one test")
    axes.set_ylabel(f"{name} of the other")
    tests = [design.candidates[i] for i in design.designs[0].tests]
    if all(map(_is_plain, tests)):
        (x,), (y,) = (test.loads for test in tests)
        _mark(axes, [x, y], [y, x], name_of_tests(design, design.designs[0]) if first else "")


def _map_of_tests(
    axes: Any, design: DesignResult, plain: IntArray, values: FloatArray, label: str
) -> None:
    """Draw the sd of one test over its load and duration, a profile being at its best instant."""
    name, loads = _axis_of(design, plain)
    seconds = sorted({design.candidates[i].seconds for i in plain})
    unit, scale = time_unit(seconds[-1])
    table = np.full((len(seconds), len(loads)), np.nan)
    for i in plain[np.argsort(design.single_scores[plain], kind="stable")]:  # the best one the last
        test = design.candidates[i]
        table[seconds.index(test.seconds), loads.index(test.loads[0])] = values[i]
    _draw(
        axes,
        loads,
        [one / scale for one in seconds],
        np.where(np.isfinite(table), table, np.nan),
        label,
    )
    axes.set_xlabel(f"{name} of one test")
    axes.set_ylabel(f"duration ({unit})")
    best = [design.candidates[i] for i in design.designs[0].tests]
    if all(map(_is_plain, best)):
        _mark(
            axes, [test.loads[0] for test in best], [test.seconds / scale for test in best],
            name_of_tests(design, design.designs[0]),
        )  # fmt: skip


def _draw(axes: Any, x: list[float], y: list[float], table: FloatArray, label: str) -> None:
    known = table[np.isfinite(table)]
    wide = len(known) > 0 and known.max() > 5.0 * known.min() > 0.0
    drawn = axes.pcolormesh(
        x, y, table, cmap=_MAP, shading="nearest", norm=LogNorm() if wide else None
    )
    bar = axes.figure.colorbar(drawn, ax=axes)
    if wide:
        bar.ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        bar.ax.yaxis.set_minor_locator(NullLocator())
    bar.ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    bar.set_label(label)


def _mark(axes: Any, x: list[float], y: list[float], name: str) -> None:
    axes.plot(x, y, "o", mfc="none", mec=COLOURS[1], mew=2, ms=10, label=f"best: {name}")
    if name:
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=8, frameon=False)


def _bars(axes: Any, design: DesignResult, j: int, scale: float, label: str) -> None:
    names = [name_of_tests(design, one, "\n+ ") for one in design.designs]
    values = [scale * one.sd[j] for one in design.designs]
    axes.barh(range(len(values)), np.where(np.isfinite(values), values, 0.0), color=COLOURS[0])
    axes.set_yticks(range(len(values)), names if j == 0 else [], fontsize=7)
    axes.invert_yaxis()
    axes.set_xlabel(label)
