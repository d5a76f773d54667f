"""What a surrogate tells, drawn: Sobol' indices, and responses over each key with their error."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import qmc

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.text import shortened
from ringwear_par.results.figures import COLOURS, plain
from ringwear_par.studies.axes import (
    GREY,
    LOG_VALUE,
    OUTPUTS,
    labelled,
    set_decades,
    set_legend,
    spans,
)
from ringwear_par.studies.predictions import Surrogate, told_share
from ringwear_par.studies.regression import Part
from ringwear_par.studies.sensitivity import SEED, SENSITIVE, SobolIndices, sobol_indices

#: panels beside each other, places along a key, and points over the other keys at each
_COLUMNS, _PLACES, _OTHERS = 4, 41, 2**8
_ROW, _INDICES = 1.9, 1.5


@dataclass(frozen=True)
class Responses:
    """The part of a sweep's figure that is drawn from its surrogate.

    Parameters
    ----------
    surrogate : whose part of most cases is drawn.
    names : responses that vary, final values.
    indices : of some of them; () of one key, or without SALib.
    """

    surrogate: Surrogate
    names: tuple[str, ...]
    indices: tuple[SobolIndices, ...]

    @classmethod
    def of(cls, surrogate: Surrogate, outputs: Sequence[str]) -> "Responses | None":
        """Return what is drawn of some outputs; None if none of them varies."""
        part = surrogate.parts[0]
        names = tuple(n for n in outputs if part.responses[n].relative_error > 0.0)
        if not names:
            return None
        sensitive = [name for name in names if name in SENSITIVE]
        found = sobol_indices(part, sensitive) if len(part.keys) > 1 else ()
        return cls(surrogate, names, found)

    @property
    def heights(self) -> list[float]:
        """Inches of the rows that it takes: one of indices, and those of curves."""
        rows = [_INDICES + 0.3 * len(self._part.keys)] if self.indices else []
        return rows + [_ROW * len(self.names) + 0.9 for _ in self._blocks]

    @property
    def _part(self) -> Part:
        return self.surrogate.parts[0]

    @property
    def _blocks(self) -> list[range]:
        """Numbers of the keys beside each other, as even as may be."""
        count = len(self._part.keys)
        columns = -(-count // -(-count // _COLUMNS))
        return [range(i, min(i + columns, count)) for i in range(0, count, columns)]

    def draw(self, parts: Sequence[Any]) -> None:
        """Draw into parts of a figure, one a row."""
        if self.indices:
            parts[0].suptitle(self._said, fontsize=8.0)
            panels = np.atleast_1d(parts[0].subplots(1, len(self.indices), sharey=True))
            for axes, found in zip(panels, self.indices, strict=True):
                self._draw_indices(axes, found)
        else:
            parts[0].suptitle(self._said, fontsize=8.0)
        for part, block in zip(parts[-len(self._blocks) :], self._blocks, strict=True):
            self._draw_curves(part, block)

    @property
    def _said(self) -> str:
        part = self._part
        said = f"surrogate of {len(part.points)} cases"
        if part.texts:
            texts = zip(self.surrogate.text_keys, part.texts, strict=True)
            said += " with " + ", ".join(f"{key} = {shortened(text)}" for key, text in texts)
        return plain(f"{said}; keys vary evenly over their ranges")

    def _error(self, name: str) -> str:
        return told_share(self._part.responses[name].relative_error)

    def _draw_indices(self, axes: Any, found: SobolIndices) -> None:
        places = np.arange(len(found.keys), dtype=float)
        for shift, colour, values, label in (
            (-0.17, COLOURS[3], found.first, "S\N{SUBSCRIPT ONE}"),
            (0.17, COLOURS[2], found.total, "S\N{LATIN SUBSCRIPT SMALL LETTER T}"),
        ):
            axes.barh(places + shift, values, 0.3, color=colour, alpha=0.75, label=label)
        axes.set_yticks(places, [plain(key) for key in found.keys])
        axes.set_ylim(len(places) - 0.5, -0.5)
        axes.set_xlim(0.0, 1.04)
        axes.grid(axis="x", linewidth=0.4, color="0.85")
        axes.set_axisbelow(True)
        axes.set_xlabel("Sobol' index of the surrogate")
        title = (
            f"{SENSITIVE[found.output]}\n{found.evaluations / 1e6:.1f} million evaluations,\n"
            f"leave-out error (of the spread): {self._error(found.output)}"
        )
        set_legend(axes, 2, title)

    def _draw_curves(self, figure: Any, keys: range) -> None:
        """Draw one row an output and one column a key."""
        part = self._part
        mean_of = "mean over the others" if len(part.keys) > 1 else "surrogate"
        panels = figure.subplots(
            len(self.names), len(keys), squeeze=False, sharex="col", sharey="row"
        )
        for row, name in enumerate(self.names):
            factor, label = OUTPUTS[name]
            response = part.responses[name]
            values = factor * response.values[:, 0]
            logarithmic = spans(values, LOG_VALUE)
            for axes, key in zip(panels[row], keys, strict=True):
                x = part.values_at(key, part.points[:, key])
                many = len(x) > 200
                axes.plot(
                    x, values, color=GREY, marker=".", linestyle="none",
                    alpha=0.5 if many else 0.7,
                    markersize=3.0 if many else 5.0, markeredgewidth=0.0, label="cases",
                    rasterized=many, zorder=1.5,
                )  # fmt: skip
                places = np.linspace(0.0, 1.0, _PLACES)
                along, mean = part.values_at(key, places), self._means(name, key, places)
                low, high = (factor * response.shifted(mean, by) for by in (-1.0, 1.0))
                axes.fill_between(
                    along, low, high, color=COLOURS[0], alpha=0.25, linewidth=0.0,
                    label="\N{PLUS-MINUS SIGN} leave-out error",
                )  # fmt: skip
                axes.plot(along, factor * mean, color=COLOURS[0], label=mean_of)
                if part.logarithmic[key]:
                    axes.set_xscale("log")
                    set_decades(axes.xaxis, along)
                else:
                    axes.locator_params(axis="x", nbins=5)
                if row == len(self.names) - 1:
                    axes.set_xlabel(labelled(part.keys[key]))
                if logarithmic:
                    axes.set_yscale("log")
                    axes.set_ylim(0.5 * values.min(), 2.0 * values.max())
            if logarithmic:
                set_decades(panels[row, 0].yaxis, values)
            final = f"final {label}" if name == "penetration" else label
            panels[row, 0].set_ylabel(f"{final}\nleave-out error\n{self._error(name)}")
        set_legend(panels[0, 0], 1, "")
        figure.align_ylabels(panels[:, 0])

    def _means(self, name: str, key: int, places: FloatArray) -> FloatArray:
        """Return the response at places of a key, the mean over the ranges of the others."""
        part = self._part
        others = qmc.Sobol(len(part.keys), seed=SEED).random(_OTHERS)
        points = np.repeat(others[None], len(places), axis=0)
        points[:, :, key] = places[:, None]
        values = part.at(points.reshape(-1, len(part.keys)), (name,))[name]
        return values.reshape(len(places), -1).mean(axis=1)
