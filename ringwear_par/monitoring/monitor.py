"""Answers to the readings of a running test: they depend on these alone, however they came."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.draws import Draws
from ringwear_par.identification.fit_numbers import in_users_unit
from ringwear_par.identification.summary import probabilities
from ringwear_par.monitoring.answer import Alarm, Answer, Goal
from ringwear_par.monitoring.follower import Follower, Specimen
from ringwear_par.monitoring.histories import part_of, times_of
from ringwear_par.monitoring.outlook import surprise, time_to, time_to_goal
from ringwear_par.pictures.panel import Axis, Band, Curve, Panel, Points
from ringwear_par.pictures.style import COLOURS
from ringwear_par.prediction.prediction import TimeTo
from ringwear_par.results.key_numbers import time_unit
from ringwear_par.results.variables import DISPLAY_UNITS

#: windows of a test in which readings are compared with what is expected of them, and the
#: probability below which they are not: 1 of 100 tests without a change has an alarm
WINDOWS = 20
_IMPROBABLE = 0.01 / WINDOWS
#: effective draws below which intervals are rough; share of the draws at edges of what was drawn
#: before, and error of histories over their spread, that are told
_FEW, _AT_EDGES, _ROUGH = 300.0, 0.01, 2e-3
#: histories of which a band is drawn
_DRAWN = 1000


@dataclass(frozen=True)
class Targets:
    """What is asked of a running test."""

    #: number of the key whose interval is to become narrow
    key: int
    #: half its width over the median
    percent: float
    #: mm, of penetration; None: none
    depth: float | None


class _Window(NamedTuple):
    #: (m, 3) low end, median and high end of the keys by the readings before the window
    intervals: FloatArray
    #: probability of each law by these
    laws: Mapping[str, float]
    #: of readings so far off in the window
    probability: float


class Monitor:
    """Answers to the readings of a running test. On the first rank, within ``Readings.lead``.

    Parameters
    ----------
    followers : of its specimen by law, "" for that of the fit.
    evidences : logarithms of the fit's, by law; empty where none is compared.
    whom : in words, of whom the draws are before the test.
    """

    def __init__(
        self,
        followers: Mapping[str, Follower],
        draws: Draws,
        evidences: Mapping[str, float],
        targets: Targets,
        whom: str,
        doubts: tuple[str, ...],
    ) -> None:
        self._followers, self._draws, self._targets = followers, draws, targets
        self._evidences, self._whom, self._doubts = evidences, whom, doubts
        #: by the readings until their end, and what is asked of them
        self._windows: dict[tuple[Any, ...], _Window] = {}

    def answer(self, problem: Problem) -> Answer:
        """Return the answer to the readings so far.

        Parameters
        ----------
        problem : of the running test, with its readings so far.
        """
        for law, follower in self._followers.items():
            if not follower.suits(of_law := problem.alternatives.get(law, problem)):
                follower.prepare(of_law)
                self._windows.clear()
        (test,), targets, follower = problem.experiments, self._targets, self._followers[""]
        times, end, window = times_of(test), test.case.time.end, test.case.time.end / WINDOWS
        before = self._intervals(follower.before, problem)
        laws_before = probabilities(self._evidences)
        trace: list[list[float]] = []
        law_trace = [[0.0, *laws_before.values()]]
        alarm, now = None, float(times.max())

        def note(time: float, intervals: FloatArray, laws: Mapping[str, float]) -> None:
            trace.append([time, *intervals[targets.key].tolist()])
            law_trace.append([time, *laws.values()])

        for number in range(1, WINDOWS):
            low, high = np.array([number, number + 1]) * window * (1.0 + 1e-9)
            old, new = times <= low, (times > low) & (times <= high)
            if high > now * (1.0 + 2e-9) or not old.any() or not new.any():
                continue
            seen = self._window(problem, old, new)
            note(float(times[old].max()), seen.intervals, seen.laws)
            if seen.probability < _IMPROBABLE:
                alarm = Alarm(float(times[new].min()), seen.probability)
                break
        counted = times < (np.inf if alarm is None else alarm.time)
        until = float(times[counted].max())
        part = part_of(test, counted)
        found = follower.update(part)
        self._found, self._test, self._level = found, part, problem.settings.level
        intervals, laws = self._intervals(found, problem), self._laws(problem, counted, found)
        if trace and trace[-1][0] >= until:
            del trace[-1], law_trace[-1]
        note(until, intervals, laws)
        units = dict(zip(self._draws.keys, self._draws.units, strict=True))
        keys: dict[str, dict[str, Any]] = {}
        for parameter, (low, median, high), (first, _, last) in zip(
            problem.parameters, intervals.tolist(), before.tolist(), strict=True
        ):
            entry = {
                "unit": units[parameter.key], "estimate": median, "interval": (low, high),
                "before": (first, last), "percent": 50.0 * (high - low) / abs(median),
            }  # fmt: skip
            told = in_users_unit(parameter, entry, problem.experiments[0].case)
            keys[parameter.key] = entry if told is None else {**entry, "told": told}
        key = problem.keys[targets.key]
        percent = keys[key]["percent"]
        when, less = time_to_goal(
            follower, found, part, targets.key, targets.percent / percent, until
        )
        depth = None
        if targets.depth is not None:
            reached = time_to(follower, found, targets.depth, until)
            depth = targets.depth, TimeTo.of(reached, problem.settings.level)
        doubts, effective = self._doubts, found.effective
        if effective < _FEW:
            doubts += (
                f"these readings leave only {effective:.0f} of {len(found.weights)} draws: "
                "intervals are rough; use more draws (--draws), and check that the earlier tests "
                "are of the same material and rig",
            )
        if follower.at_edges(found) > _AT_EDGES:
            doubts += (
                "this specimen is beyond almost all that the earlier tests let expect: intervals "
                "are cut off there; check that they are of the same material and rig",
            )
        if follower.histories.error > _ROUGH:
            doubts += (
                f"histories between draws are known to {100 * follower.histories.error:.2g} % of "
                "their spread: a layer is worn through, or a threshold is reached, at some draws",
            )
        return Answer(
            test.name, self._whom, now, end, len(times), problem.settings.level, keys,
            Goal(key, targets.percent, when, percent * less), depth, alarm, np.array(trace),
            len(found.weights), effective, found.redraws, follower.histories.error, doubts,
            {law or "this law": (laws_before[law], laws[law]) for law in laws},
            np.array(law_trace),
        )  # fmt: skip

    def _window(self, problem: Problem, old: BoolArray, new: BoolArray) -> _Window:
        """Return what old readings tell, and how probable new ones are by them."""
        (test,), follower = problem.experiments, self._followers[""]
        both = part_of(test, old | new)
        content: tuple[Any, ...] = (problem.settings.level,)
        for s in both.series:
            limits = np.array(s.censored).tobytes()
            columns = s.x.tobytes(), s.value.tobytes(), s.sd.tobytes(), limits
            content += (s.name, s.nuisances, s.correlation_time, s.sd_fitted, *columns)
        if content not in self._windows:
            found = follower.update(part_of(test, old))
            told = times_of(both) > times_of(test)[old].max()
            p = surprise(follower, found, both, told) if found.likelihood else 1.0
            laws = self._laws(problem, old, found)
            self._windows[content] = _Window(self._intervals(found, problem), laws, p)
        return self._windows[content]

    def _laws(self, problem: Problem, counted: BoolArray, found: Specimen) -> dict[str, float]:
        """Return the probability of each law by the readings that count."""
        evidences = {}
        for law, before in self._evidences.items():
            if law:
                (test,) = problem.alternatives[law].experiments
                evidence = self._followers[law].update(part_of(test, counted)).log_evidence
            evidences[law] = before + (evidence if law else found.log_evidence)
        return probabilities(evidences)

    def _intervals(self, found: Specimen, problem: Problem) -> FloatArray:
        """Return low end, median and high end of each key, (m, 3)."""
        tail = 0.5 * (1.0 - problem.settings.level)
        columns = self._draws.values(found.unknowns[:, : len(self._draws.keys)]).T
        return np.array([quantiles(c, found.weights, (tail, 0.5, 1.0 - tail)) for c in columns])

    def record(self) -> Panel | None:
        """Return the panel of the first record of penetration, approach or torque."""
        found, histories, test = self._found, self._followers[""].histories, self._test
        rows = np.cumsum([0, *(series.n for series in test.series)])
        places = {s.quantity: i for i, s in reversed([*enumerate(test.series)])}
        known = [places[q] for q in ("penetration", "approach", "torque") if q in places]
        if not known or found.likelihood is None:
            return None
        series, quantity = test.series[known[0]], test.series[known[0]].quantity
        steps = histories.at_steps(quantity.replace("penetration", "approach"))
        steps = steps - steps[0] if quantity == "penetration" else steps
        tail = 0.5 * (1.0 - self._level)
        curves = np.quantile(found.chosen(_DRAWN) @ steps.T, (tail, 0.5, 1.0 - tail), axis=0)
        added = found.likelihood.likelihood.nuisance_draws(found.middle[None])[0][0]
        value = series.value - added[rows[known[0]] : rows[known[0] + 1]]
        symbol, factor = DISPLAY_UNITS.get(quantity, ("N mm", 1.0))
        unit, seconds = time_unit(test.case.time.end)
        time, (low, median, high) = histories.time / seconds, factor * curves
        level = f"{100 * self._level:g} %"
        return Panel(
            Axis(f"time ({unit})"), Axis(f"{quantity} ({symbol})", zero=True),
            "readings, and histories of this specimen",
            curves=[Curve(time, median, "median", COLOURS[1])],
            bands=[Band(time, low, high, level, ("low", "high"))],
            points=[Points(series.x / seconds, factor * value, "readings, less offset and drift")],
        )  # fmt: skip


def quantiles(values: FloatArray, weights: FloatArray, probabilities: Any) -> FloatArray:
    """Return quantiles of weighed values (draws,)."""
    order = np.argsort(values)
    centred = np.cumsum(weights[order]) - 0.5 * weights[order]
    between: FloatArray = np.interp(probabilities, centred, values[order])
    return between
