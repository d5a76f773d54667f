"""A running test under watch: its readings are judged window by window, and answered."""

from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.identification.definition.fitted_parameters import units_of
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.monitoring.answer import Alarm, Answer, Goal, KeyAnswer
from ringwear_par.monitoring.bank import Bank, effective, quantiles
from ringwear_par.monitoring.outlook import surprise, time_to, times_of, widths
from ringwear_par.pictures.panels import Axis, Band, Curve, Panel, Points
from ringwear_par.pictures.style import COLOURS
from ringwear_par.prediction.prediction import TimeTo
from ringwear_par.results.key_numbers import time_unit
from ringwear_par.results.variables import DISPLAY_UNITS

#: windows of a test in which readings are compared with what is expected of them
_WINDOWS = 20
#: probability below which they are not
_IMPROBABLE = 1e-5


@dataclass(frozen=True)
class Wishes:
    """What is asked of a running test."""

    #: number of the key whose interval is to become narrow
    key: int
    #: half its width over the median
    percent: float
    #: mm, of penetration; None: none
    depth: float | None


class Watch:
    """The state of a running test.

    Parameters
    ----------
    bank : of its histories.
    whom : in words, of whom the draws are before the test.
    """

    def __init__(self, bank: Bank, wishes: Wishes, whom: str, doubts: tuple[str, ...]) -> None:
        self._bank, self._wishes, self._whom, self._doubts = bank, wishes, whom, doubts
        count = len(bank.draws.base)
        self._before = self._intervals(np.full(count, 1.0 / count))
        self._begin()

    def _begin(self) -> None:
        """Forget what was judged, of a file that was replaced."""
        self._judged = 0.0
        self._alarm: Alarm | None = None
        self._trace: list[list[float]] = []
        self._readings = np.zeros(0)

    @property
    def _probabilities(self) -> list[float]:
        tail = 0.5 * (1.0 - self._bank.problem.settings.level)
        return [tail, 0.5, 1.0 - tail]

    def _intervals(self, weights: FloatArray) -> FloatArray:
        """Return low end, median and high end of each key, (m, 3)."""
        columns = self._bank.values.T
        return np.array([quantiles(v, weights, self._probabilities) for v in columns])

    def answer(self, problem: Problem) -> Answer:
        """Return the answer to the readings so far.

        Parameters
        ----------
        problem : of the running test, with its readings so far.
        """
        bank, wishes, settings = self._bank, self._wishes, problem.settings
        experiment, times = problem.experiments[0], times_of(problem)
        self._compare(experiment.series[0].value)
        self._judge(problem, times)
        counted = times < (np.inf if self._alarm is None else self._alarm.time)
        weights = bank.update(problem, counted)
        intervals = self._intervals(weights)
        end, now = experiment.case.time.end, float(times.max())
        until = float(times[counted].max(initial=0.0))
        self._note(until, intervals)
        units = units_of(problem)
        keys = {
            key: KeyAnswer(
                units[key],
                median,
                (low, high),
                (before[0], before[2]),
                50.0 * (high - low) / abs(median),
            )
            for key, (low, median, high), before in zip(
                problem.keys, intervals.tolist(), self._before.tolist(), strict=True
            )
        }
        key = problem.keys[wishes.key]
        at, half = widths(bank, problem, weights, wishes.key, settings.level)
        half *= keys[key].percent / half[0]  # what is known now is known better
        reached = np.flatnonzero(half <= wishes.percent)
        when = float(at[reached[0]]) if len(reached) else None
        goal = Goal(key, wishes.percent, when, float(half[-1]))
        depth = None
        if wishes.depth is not None:
            reached_at = time_to(bank, problem, weights, wishes.depth)
            depth = wishes.depth, TimeTo.of(reached_at, settings.level)
        self._weights = weights
        return Answer(
            experiment.name, self._whom, now, end, len(times), settings.level, keys, goal, depth,
            self._alarm, np.array(self._trace), len(weights), effective(weights), bank.moves,
            bank.histories.error, self._doubts,
        )  # fmt: skip

    def _compare(self, readings: FloatArray) -> None:
        """Begin anew where the readings are not those of before, and more."""
        common = readings[: len(self._readings) - 1]  # the last block of an average may grow
        if len(common) < len(self._readings) - 1 or not np.array_equal(
            common, self._readings[: len(common)]
        ):
            self._begin()
        self._readings = readings

    def _judge(self, problem: Problem, times: FloatArray) -> None:
        """Compare the readings of all windows that are full with what is expected of them."""
        window, last = problem.experiments[0].case.time.end / _WINDOWS, float(times.max())
        while self._alarm is None and self._judged + window <= last * (1.0 + 1e-9):
            old = times <= self._judged
            new: BoolArray = (times > self._judged) & (
                times <= self._judged + window * (1.0 + 1e-9)
            )
            if old.any() and new.any():
                weights = self._bank.update(problem, old)
                test = self._bank.linearised(problem)[0]
                p = surprise(self._bank, test, weights, old, new)
                if p < _IMPROBABLE:
                    self._alarm = Alarm(float(times[new].min()), p)
                self._note(float(times[old].max()), self._intervals(weights))
            self._judged += window

    def _note(self, time: float, intervals: FloatArray) -> None:
        row = [time, *intervals[self._wishes.key].tolist()]
        if self._trace and self._trace[-1][0] >= time:
            self._trace.pop()
        self._trace.append(row)

    def record(self, problem: Problem) -> Panel | None:
        """Return the panel of the first record of penetration, approach or torque."""
        (experiment,) = problem.experiments
        named = ("penetration", "approach", "torque")
        rows = np.cumsum([0, *(series.n for series in experiment.series)])
        for first, series in zip(rows.tolist(), experiment.series, strict=False):
            if series.quantity not in named:
                continue
            bank = self._bank
            modes = getattr(
                bank.histories.modes(), series.quantity.replace("penetration", "approach")
            )
            modes = modes - modes[0] if series.quantity == "penetration" else modes
            curves = modes[:, 0] + np.nan_to_num(bank.draws.coordinates) @ modes[:, 1:].T
            band = np.array([quantiles(c, self._weights, self._probabilities) for c in curves.T]).T
            _, misfit, x = bank.linearised(problem)
            beside = misfit.nuisance_readings(x)[first : first + series.n]
            unit, seconds = time_unit(experiment.case.time.end)
            symbol, factor = DISPLAY_UNITS.get(series.quantity, ("N mm", 1.0))
            time, (low, median, high) = bank.histories.time / seconds, factor * band
            level = f"{100 * problem.settings.level:g} %"
            readings = factor * (series.value - beside)
            return Panel(
                Axis(f"time ({unit})"), Axis(f"{series.quantity} ({symbol})", zero=True),
                "readings, and histories of this specimen",
                curves=[Curve(time, median, "median", COLOURS[1])],
                bands=[Band(time, low, high, level, ("low", "high"))],
                points=[Points(series.x / seconds, readings, "readings, less offset and drift")],
            )  # fmt: skip
        return None
