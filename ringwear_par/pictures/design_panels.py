"""Panels of a test design: predicted standard deviations over loads, or load and duration."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ringwear_par.cases.schema import quantity_label
from ringwear_par.pictures.panel import Axis, Bars, Cells, Panel, Points
from ringwear_par.pictures.style import COLOURS


def design_panels(outcome: Mapping[str, Any]) -> list[Panel]:
    """Return the predicted standard deviations of each key: a map, or bars of the best designs."""
    panels = []
    for key, scale in outcome["sd_scales"].items():
        label = f"predicted sd of {quantity_label(key, scale['unit'])}"
        if outcome["map"] is None:
            panels.append(_bars(outcome, key, scale["factor"], label))
        else:
            panels.append(_map(outcome, key, scale["factor"], label))
    return panels


def _map(outcome: Mapping[str, Any], key: str, factor: float, label: str) -> Panel:
    table, best = outcome["map"], outcome["map"]["best"]
    x, y = (np.array(table[name]["values"]) for name in ("x", "y"))
    cells = Cells(x, y, factor * np.array(table["sd"][key], dtype=float), label)
    name = f"best: {outcome['designs'][0]['name']}"
    marks = [Points(np.array(best["x"]), np.array(best["y"]), name, COLOURS[4], 14.0, hollow=True)]
    axes = Axis(table["x"]["label"]), Axis(table["y"]["label"])
    return Panel(*axes, cells=cells, points=marks if best["x"] else [])


def _bars(outcome: Mapping[str, Any], key: str, factor: float, label: str) -> Panel:
    names = tuple(design["name"].replace(" + ", "\n+ ") for design in outcome["designs"])
    values = np.array([design["sd"][key] for design in outcome["designs"]], dtype=float)
    bars = Bars(np.arange(len(values), dtype=float), factor * np.nan_to_num(values), "", COLOURS[0])
    return Panel(Axis(label, zero=True), Axis("", reversed=True, categories=names), bars=[bars])
