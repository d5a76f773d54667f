"""What the readings of a running test say so far: in text, as JSON, as a page."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.units import in_signs, with_signs
from ringwear_par.errors import counted
from ringwear_par.identification.summary import users_numbers
from ringwear_par.pictures.panel import Axis, Band, Curve, Panel
from ringwear_par.pictures.style import COLOURS
from ringwear_par.prediction.prediction import TimeTo, depth_words
from ringwear_par.reports import blocks
from ringwear_par.results.key_numbers import time_unit, time_words

#: s, after which a browser loads the page of a running test again; share of its time from which
#: on a test has ended
_REFRESH, _ENDED = 10, 0.999


class Goal(NamedTuple):
    """When the interval of a key is as narrow as is wished."""

    key: str
    #: half its width over the median, at most
    percent: float
    #: s, expected; None: not before the end of the test
    time: float | None
    #: half width in percent that is expected there
    at_end: float


class Alarm(NamedTuple):
    """Readings left the predicted band."""

    #: s, of the first of them
    time: float
    #: of readings so far off
    probability: float


@dataclass(frozen=True, eq=False)
class Answer:
    """What is known of a specimen at a time of its test; the contents of follow.json."""

    #: name of the experiment
    test: str
    #: of whom the draws are before the test
    whom: str
    #: s, of the last reading, and of the test
    time: float
    end: float
    #: number of readings
    readings: int
    #: of intervals
    level: float
    #: entries of the keys of this specimen: median and interval by the readings, the interval
    #: before the test, half the interval over the median; in the user's unit as in fit.json
    keys: Mapping[str, Mapping[str, Any]]
    goal: Goal
    #: mm, whose time is asked, and when it is reached; None: none is asked
    depth: tuple[float, TimeTo] | None
    alarm: Alarm | None
    #: (answers, 4) time, low end, median and high end of the goal's key
    trace: FloatArray
    draws: int
    #: number of independent draws
    effective_count: float
    #: how often they were made anew
    redraws: int
    #: error of histories between those that were computed, over their spread among the draws
    interpolated: float
    doubts: Sequence[str]
    #: probability of each law before the test and by the readings, by name; empty: one law only
    laws: Mapping[str, tuple[float, float]]
    #: (answers + 1, 1 + laws) time, probability of each law; before the test at 0
    law_trace: FloatArray

    @property
    def ended(self) -> bool:
        """Whether the test has ended."""
        return self.time >= _ENDED * self.end

    @property
    def warnings(self) -> list[str]:
        """What speaks against the numbers, the alarm first."""
        if self.alarm is None:
            return [*self.doubts]
        words = (
            f"alarm: readings leave the predicted band from {self._at(self.alarm.time)} on (p = "
            f"{self.alarm.probability:.1g}): a transition, a layer worn through, or the rig; all "
            "numbers are of the readings before"
        )
        return [words, *self.doubts]

    @property
    def left(self) -> str:
        """How long it takes to the goal, in words."""
        if self.goal.time is None:
            return "not before the end"
        left = self.goal.time - self.time
        return "reached" if left <= 0.0 else f"in {self._at(left)}"

    def lines(self, *, warnings: bool = True) -> list[str]:
        """Return the answer in lines of text, with or without warnings."""
        goal, level = self.goal, f"{100 * self.level:g} %"
        lines = [f"{self.test}: {counted(self.readings, 'reading')} to {self._at(self.time)} of "
                 f"{self._at(self.end)}"]  # fmt: skip
        for key, entry in self.keys.items():
            numbers, unit = users_numbers(entry)
            (low, high), (first, last) = numbers["interval"], numbers["before"]
            estimate = f"{numbers['estimate']:.3g} {unit}".rstrip()
            lines.append(
                f"  {key}  {estimate} of this specimen  from {low:.3g} to {high:.3g} ({level}, "
                f"+-{entry['percent']:.2g} %; before the test {first:.3g} to {last:.3g})"
            )
        expected = f", +-{goal.at_end:.2g} % is expected there" if goal.time is None else ""
        lines.append(f"  {goal.key} to +-{goal.percent:g} %: {self.left}{expected}")
        if self.depth is not None:
            depth, when = self.depth
            lines.append(f"  {depth_words(depth)}: {when.words(self.end)}")
        if self.laws:
            shares = [
                f"{law} {probability_words(now)} (before the test {probability_words(before)})"
                for law, (before, now) in self.laws.items()
            ]
            lines.append(f"  probability of laws: {', '.join(shares)}")
        return [*lines, *(f"warning: {words}" for words in self.warnings if warnings)]

    def _at(self, time: float) -> str:
        return time_words(time, self.end)

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of follow.json."""
        depth = self.depth and {"depth": self.depth[0], **self.depth[1]._asdict()}
        return asdict(self) | {
            "goal": self.goal._asdict(), "alarm": self.alarm and self.alarm._asdict(),
            "depth": depth, "trace": self.trace.tolist(), "summary": self.lines(),
            "law_trace": self.law_trace.tolist() if self.laws else [],
        }  # fmt: skip

    def page(self, record: Panel | None, command: str, versions: Mapping[str, str]) -> blocks.Page:
        """Return the page, which a browser loads anew while the test runs.

        Parameters
        ----------
        record : the readings with their band; None: there is none.
        """
        unit, seconds = time_unit(self.end)
        goal, key, warnings = self.goal, self.keys[self.goal.key], self.warnings
        axis = Axis(f"time ({unit})")
        numbers, unit_of_key = users_numbers(key)
        time = self.trace[:, 0] / seconds
        low, median, high = self.trace[:, 1:].T / numbers["scale"]
        of_key = Panel(
            axis, Axis(f"{goal.key} ({in_signs(unit_of_key or '1')})"),
            "by the readings until then",
            curves=[Curve(time, median, "median", COLOURS[1], marked=True)],
            bands=[Band(time, low, high, f"{100 * self.level:g} %", ("low", "high"))],
        )  # fmt: skip
        words = f"{goal.key} and its interval over the time of the test"
        charts = [blocks.Chart("key", of_key, words)]
        if self.laws:
            time, shares = self.law_trace[:, 0] / seconds, 100.0 * self.law_trace[:, 1:].T
            curves = [
                Curve(time, share.round(1), law, COLOURS[i % len(COLOURS)], i // len(COLOURS),
                      marked=True)
                for i, (law, share) in enumerate(zip(self.laws, shares, strict=True))
            ]  # fmt: skip
            of_laws = Axis("probability of the law (%)", (-3.0, 103.0))
            panel = Panel(axis, of_laws, "laws, by the readings until then", curves=curves)
            words = "Probability of each law over the time of the test"
            charts.append(blocks.Chart("laws", panel, words))
        if record is not None:
            words = "Readings, and histories of this specimen"
            charts.append(blocks.Chart("record", record, words))
        tiles = [
            blocks.Tile(goal.key, f"{numbers['estimate']:.3g}", in_signs(unit_of_key),
                        with_signs(f"+-{key['percent']:.2g} %")),
            blocks.Tile(with_signs(f"to +-{goal.percent:g} %"), self.left),
            blocks.Tile("readings", "as expected" if self.alarm is None else "alarm",
                        note=f"{self.readings} to {self._at(self.time)}", good=self.alarm is None),
        ]  # fmt: skip
        lines = blocks.Lines([with_signs(line) for line in self.lines(warnings=False)])
        summary: list[blocks.Lines | blocks.Tiles] = [blocks.Tiles(tiles), lines]
        summary += [blocks.Lines(warnings, warning=True)] * bool(warnings)
        source, software = blocks.Source("Command", command), blocks.software(dict(versions))
        sections = [
            blocks.Section("Summary", summary),
            blocks.Section("Over time", [blocks.Charts(charts)]),
            blocks.Section("How to reproduce", [source, software]),
        ]
        refresh = 0 if self.ended else _REFRESH
        return blocks.Page("Running test", self.test, sections, refresh=refresh)


def probability_words(probability: float) -> str:
    """Return a probability in percent, without digits that tell nothing."""
    return "< 0.1 %" if probability < 1e-3 else f"{100.0 * probability:.3g} %"
