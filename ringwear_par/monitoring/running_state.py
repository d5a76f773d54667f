"""The state of a running test: its readings are judged window by window, and answered."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.identification.definition.fitted_parameters import units_of
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.fit_numbers import in_users_unit
from ringwear_par.identification.summary import probabilities
from ringwear_par.monitoring.answer import Alarm, Answer, Goal
from ringwear_par.monitoring.bank import Bank, are_too_few, effective_count, quantiles
from ringwear_par.monitoring.outlook import surprise, time_to, times_of, widths
from ringwear_par.pictures.panel import Axis, Band, Curve, Panel, Points
from ringwear_par.pictures.style import COLOURS
from ringwear_par.prediction.prediction import TimeTo
from ringwear_par.results.key_numbers import time_unit
from ringwear_par.results.variables import DISPLAY_UNITS

#: windows of a test in which readings are compared with what is expected of them
_WINDOWS = 20
#: probability below which they are not
_IMPROBABLE = 1e-5


@dataclass(frozen=True)
class Targets:
    """What is asked of a running test."""

    #: number of the key whose interval is to become narrow
    key: int
    #: half its width over the median
    percent: float
    #: mm, of penetration; None: none
    depth: float | None


class RunningTestState:
    """The state of a running test.

    Parameters
    ----------
    new_bank : returns the bank of its histories before there are readings, under a law that is
        compared by its name; "": under that of the fit.
    evidences : logarithms of the fit's, by law; empty where none is compared.
    whom : in words, of whom the draws are before the test.
    """

    def __init__(
        self,
        new_bank: Callable[[str], Bank],
        evidences: Mapping[str, float],
        targets: Targets,
        whom: str,
        doubts: tuple[str, ...],
    ) -> None:
        self._new_bank, self._targets, self._whom, self._doubts = new_bank, targets, whom, doubts
        self._evidences = evidences
        self._begin()

    def _begin(self) -> None:
        """Make the bank, without readings: at first, and where another record has replaced them."""
        self._bank = self._new_bank("")
        self._other_banks = {law: self._new_bank(law) for law in self._evidences if law}
        count = len(self._bank.draws.unknowns)
        self._before = self._intervals(np.full(count, 1.0 / count))
        self._judged = 0.0
        self._alarm: Alarm | None = None
        #: by time: ends and median of the goal's key; probabilities of laws
        self._trace: list[list[float]] = []
        self._law_trace: list[list[float]] = []
        self._readings: dict[str, FloatArray] = {}

    @property
    def _probabilities(self) -> list[float]:
        tail = 0.5 * (1.0 - self._bank.problem.settings.level)
        return [tail, 0.5, 1.0 - tail]

    def _intervals(self, weights: FloatArray) -> FloatArray:
        """Return low end, median and high end of each key, (m, 3)."""
        columns = self._bank.values.T
        return np.array([quantiles(values, weights, self._probabilities) for values in columns])

    def answer(self, problem: Problem) -> Answer:
        """Return the answer to the readings so far.

        Parameters
        ----------
        problem : of the running test, with its readings so far.
        """
        targets, settings = self._targets, problem.settings
        experiment, times = problem.experiments[0], times_of(problem)
        self._compare({series.name: series.value for series in experiment.series})
        self._judge(problem, times)
        bank = self._bank
        counted = times < (np.inf if self._alarm is None else self._alarm.time)
        weights = bank.update(problem, counted)
        laws = self._probabilities_of_laws(problem, counted)
        intervals = self._intervals(weights)
        end, now = experiment.case.time.end, float(times.max())
        until = float(times[counted].max(initial=0.0))
        self._note(until, intervals, laws)
        units = units_of(problem)
        keys: dict[str, dict[str, Any]] = {}
        for parameter, (low, median, high), (first, _, last) in zip(
            problem.parameters, intervals.tolist(), self._before.tolist(), strict=True
        ):
            entry = {
                "unit": units[parameter.key], "estimate": median, "interval": (low, high),
                "before": (first, last), "percent": 50.0 * (high - low) / abs(median),
            }  # fmt: skip
            converted = in_users_unit(parameter, entry, experiment.case)
            keys[parameter.key] = entry if converted is None else {**entry, "told": converted}
        depth = None
        if targets.depth is not None:
            reached_at = time_to(bank, problem, weights, targets.depth, counted)
            depth = targets.depth, TimeTo.of(reached_at, settings.level)
        key = problem.keys[targets.key]
        at, half = widths(bank, problem, weights, targets.key, settings.level, until)
        half *= keys[key]["percent"] / half[0]  # what is known now is known better
        reached = np.flatnonzero(half <= targets.percent)
        when = float(at[reached[0]]) if len(reached) else None
        goal = Goal(key, targets.percent, when, float(half[-1]))
        doubts, worth = self._doubts, effective_count(weights)
        if are_too_few(weights):
            doubts += (
                f"these readings leave only {worth:.0f} of {len(weights)} draws: intervals are "
                "rough; use more draws (--draws), and check that the earlier tests are of the same "
                "material and rig",
            )
        self._weights = weights
        return Answer(
            experiment.name, self._whom, now, end, len(times), settings.level, keys, goal, depth,
            self._alarm, np.array(self._trace), len(weights), worth, bank.redraws,
            bank.histories.error, doubts, laws, np.array(self._law_trace),
        )  # fmt: skip

    def _probabilities_of_laws(
        self, problem: Problem, counted: BoolArray
    ) -> dict[str, tuple[float, float]]:
        """Return how probable each law is before the test, and by the readings that count."""
        reading_evidences = {"": self._bank.log_evidence}
        for law, bank in self._other_banks.items():
            bank.update(problem.alternatives[law], counted)
            reading_evidences[law] = bank.log_evidence
        before = probabilities(self._evidences)
        now = probabilities({law: e + reading_evidences[law] for law, e in self._evidences.items()})
        return {law or "this law": (share, now[law]) for law, share in before.items() if law in now}

    def _compare(self, readings: dict[str, FloatArray]) -> None:
        """Begin anew where the readings (n,) of a series are not those of before, and more."""
        for name, before in self._readings.items():
            whole = max(len(before) - 1, 0)  # the last block of an average may grow
            if not np.array_equal(readings.get(name, before[:0])[:whole], before[:whole]):
                self._begin()
                break
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
                laws = self._probabilities_of_laws(problem, old)
                self._note(float(times[old].max()), self._intervals(weights), laws)
            self._judged += window

    def _note(
        self, time: float, intervals: FloatArray, laws: Mapping[str, tuple[float, float]]
    ) -> None:
        """Add what is known at a time to the traces."""
        if not self._law_trace:
            self._law_trace.append([0.0, *(before for before, _ in laws.values())])
        rows = intervals[self._targets.key].tolist(), [now for _, now in laws.values()]
        for trace, row in zip((self._trace, self._law_trace), rows, strict=True):
            if trace and trace[-1][0] >= time:
                trace.pop()
            trace.append([time, *row])

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
            nuisances = misfit.nuisance_readings(x)[first : first + series.n]
            unit, seconds = time_unit(experiment.case.time.end)
            symbol, factor = DISPLAY_UNITS.get(series.quantity, ("N mm", 1.0))
            time, (low, median, high) = bank.histories.time / seconds, factor * band
            level = f"{100 * problem.settings.level:g} %"
            readings = factor * (series.value - nuisances)
            return Panel(
                Axis(f"time ({unit})"), Axis(f"{series.quantity} ({symbol})", zero=True),
                "readings, and histories of this specimen",
                curves=[Curve(time, median, "median", COLOURS[1])],
                bands=[Band(time, low, high, level, ("low", "high"))],
                points=[Points(series.x / seconds, readings, "readings, less offset and drift")],
            )  # fmt: skip
        return None
