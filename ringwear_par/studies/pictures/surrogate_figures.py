"""What a surrogate tells, drawn: responses over each key with their error."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import qmc

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.text import shortened
from ringwear_par.pictures.style import COLOURS, plain, set_legend
from ringwear_par.studies.analysis.predictions import USELESS, Surrogate, told_share
from ringwear_par.studies.analysis.regression import SEED, Part, untested
from ringwear_par.studies.definition.axes import (
    GREY,
    LOG_VALUE,
    labelled,
    least_range,
    set_decades,
    spans,
    upright,
)
from ringwear_par.studies.storage.end_values import display_of

#: panels beside each other, places along a key, and points over the other keys at each
_COLUMNS, _PLACES, _OTHERS = 4, 41, 2**8
_ROW = 1.9
#: of a title: inches of a line, and its letters
_LINE, _LETTERS = 0.15, 100


@dataclass(frozen=True)
class Responses:
    """The part of a sweep's figure that is drawn from its surrogate.

    Parameters
    ----------
    surrogate : whose part of most cases is drawn.
    names : responses that vary and are told well enough, final values.
    coarse : those that vary and are not.
    keys : numbers of the part's keys over which they are drawn.
    """

    surrogate: Surrogate
    names: tuple[str, ...]
    coarse: tuple[str, ...]
    keys: tuple[int, ...]

    @classmethod
    def of(
        cls, surrogate: Surrogate, outputs: Sequence[str], keys: Sequence[str]
    ) -> "Responses | None":
        """Return what is drawn of some outputs over some keys; None if nothing varies."""
        part = surrogate.parts[0]
        there = [name for name in outputs if name in part.responses]
        errors = {name: part.responses[name].relative_error for name in there}
        names = tuple(name for name, error in errors.items() if 0.0 < error <= USELESS)
        coarse = tuple(name for name, error in errors.items() if error > USELESS)
        over = tuple(i for i, key in enumerate(part.keys) if key in keys)
        return cls(surrogate, names, coarse, over) if (names or coarse) and over else None

    def shows(self, key: str) -> bool:
        """Tell whether all cases are shown over a key, but for those that are left out by lot."""
        whole = bool(self.names) and not self.coarse and len(self.surrogate.parts) == 1
        return whole and key in self._part.keys

    @property
    def over(self) -> dict[str, int]:
        """The keys over which it draws, with their numbers."""
        return {self._part.keys[i]: i for i in self.keys}

    @property
    def columns(self) -> int:
        """Number of panels beside each other."""
        return max(map(len, self._blocks)) if self.names else 0

    @property
    def heights(self) -> list[float]:
        """Inches of the rows that it takes."""
        if not self.names:
            return [0.1 + _LINE * len(self._title)]
        rows = [_ROW * len(self.names) + 1.1 for _ in self._blocks]
        return [rows[0] + _LINE * (len(self._title) - 2), *rows[1:]]

    @property
    def _title(self) -> list[str]:
        """What is said, in lines."""
        return [plain(line) for told in self.said for line in textwrap.wrap(told, _LETTERS)]

    @property
    def _part(self) -> Part:
        return self.surrogate.parts[0]

    @property
    def _blocks(self) -> list[tuple[int, ...]]:
        """The keys beside each other, as even as may be."""
        count = len(self.keys)
        columns = -(-count // -(-count // _COLUMNS))
        return [self.keys[i : i + columns] for i in range(0, count, columns)]

    def draw(self, parts: Sequence[Any]) -> None:
        """Draw into parts of a figure, one a row."""
        parts[0].suptitle("\n".join(self._title), fontsize=8.0)
        if not self.names:
            return
        for number, (part, block) in enumerate(zip(parts, self._blocks, strict=True)):
            self._draw_curves(part, block, legend=not number)

    @property
    def said(self) -> tuple[str, ...]:
        """What the surrogate is of, how good it is, and what is not drawn for its errors."""
        part = self._part
        said = f"surrogate of {len(part.points)} cases"
        if part.texts:
            texts = zip(self.surrogate.text_keys, part.texts, strict=True)
            said += " with " + ", ".join(f"{key} = {shortened(text)}" for key, text in texts)
        told = [said]
        if self.names:
            told = [f"{said}; keys vary evenly over their ranges"]
            told.append(f"leave-out errors, of the spread: {self._errors(self.names)}")
        if self.coarse:
            told.append(
                f"not drawn, for leave-out errors above {100.0 * USELESS:.0f} % of the spread: "
                f"{self._errors(self.coarse)}; more cases, or more values of keys that have few, "
                "make these smaller"
            )
        two = [part.keys[i] for i in untested(part.points)]
        if two and self.names:
            told.append(f"no case tests it between the two values of {', '.join(two)}")
        return tuple(told)

    def _errors(self, names: Sequence[str]) -> str:
        responses = self._part.responses
        return "; ".join(
            f"{display_of(name).name} {told_share(responses[name].relative_error)}"
            for name in names
        )

    def _draw_curves(self, figure: Any, keys: Sequence[int], *, legend: bool) -> None:
        """Draw one row an output and one column a key."""
        part = self._part
        mean_of = "mean over the others" if len(part.keys) > 1 else "surrogate"
        panels = figure.subplots(
            len(self.names), len(keys), squeeze=False, sharex="col", sharey="row"
        )
        for row, name in enumerate(self.names):
            factor, label = display_of(name).factor, display_of(name).label
            values = factor * part.responses[name].values[:, 0]
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
                along, mean, low, high = self.curve(name, key)
                axes.fill_between(
                    along, factor * low, factor * high, color=COLOURS[1], alpha=0.6, linewidth=0.9,
                    label="\N{PLUS-MINUS SIGN} 2 leave-out errors",
                )  # fmt: skip
                axes.plot(along, factor * mean, color=COLOURS[0], linewidth=0.6, label=mean_of)
                if part.logarithmic[key]:
                    axes.set_xscale("log")
                    set_decades(axes.xaxis, along)
                else:
                    axes.locator_params(axis="x", nbins=3 if along.max() >= 1e4 else 5)
                if row == len(self.names) - 1:
                    axes.set_xlabel(labelled(part.keys[key]))
                if logarithmic:
                    axes.set_yscale("log")
                    axes.set_ylim(0.5 * values.min(), 2.0 * values.max())
            if logarithmic:
                set_decades(panels[row, 0].yaxis, values)
            else:  # of all panels beside each other
                panels[row, 0].set_ylim(least_range(*panels[row, 0].get_ylim()))
            panels[row, 0].set_ylabel(upright(f"final {label}" if name == "penetration" else label))
        if legend:
            set_legend(panels[0, 0], 1, "")
        figure.align_ylabels(panels[:, 0])

    def curve(self, name: str, key: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return places along a key, the mean there, and it less and plus 2 leave-out errors."""
        part, places = self._part, np.linspace(0.0, 1.0, _PLACES)
        mean, response = self._means(name, key, places), part.responses[name]
        low, high = (response.shifted(mean, by) for by in (-2.0, 2.0))
        return part.values_at(key, places), mean, low, high

    def _means(self, name: str, key: int, places: FloatArray) -> FloatArray:
        """Return the response at places of a key, the mean over the ranges of the others."""
        part = self._part
        others = qmc.Sobol(len(part.keys), seed=SEED).random(_OTHERS)
        points = np.repeat(others[None], len(places), axis=0)
        points[:, :, key] = places[:, None]
        values = part.at(points.reshape(-1, len(part.keys)), (name,))[name]
        return values.reshape(len(places), -1).mean(axis=1)
