"""Answers to the readings of a running test: they depend on these alone, however they came."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.identification.definition.problem import Problem, records
from ringwear_par.identification.draws import NEXT, Draws
from ringwear_par.identification.summary import probabilities
from ringwear_par.identification.users_units import in_users_unit
from ringwear_par.monitoring.answer import lines_of
from ringwear_par.monitoring.follower import Follower, Specimen
from ringwear_par.monitoring.histories import part_of
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
#: effective draws below which intervals are rough; error of histories over their spread that is
#: told; share of the draws that is told at edges of what was drawn before, and part of the box
#: that is at its edges
_FEW, _ROUGH, _AT_EDGES, _EDGE = 300.0, 2e-3, 0.01, 0.97
#: histories of which a band is drawn
_DRAWN = 1000
#: share of its time from which on a test has ended
_ENDED = 0.999


@dataclass(frozen=True)
class Asked:
    """What is asked of a running test."""

    #: number of the key whose interval is to become narrow: half its width over the median
    key: int
    percent: float
    #: mm, of penetration; None: none
    depth: float | None
    #: of whom the draws are before the test, and the doubts that there are then
    whom: str = NEXT
    doubts: tuple[str, ...] = ()


class Monitor:
    """Answers to the readings of a running test. On the first rank, within ``Readings.lead``.

    Parameters
    ----------
    followers : of its specimen by law, "" for that of the fit.
    evidences : logarithms of the fit's, by law; empty where none is compared.
    """

    def __init__(
        self,
        followers: Mapping[str, Follower],
        draws: Draws,
        evidences: Mapping[str, float],
        asked: Asked,
    ) -> None:
        self._followers, self._draws, self._asked = followers, draws, asked
        self._level = followers[""].problem.settings.level
        self._evidences, self._before = evidences, self._intervals(followers[""].before)
        #: entry of the trace and probability of a window, by the readings until its end
        self._windows: dict[Hashable, tuple[list[float], float]] = {}

    def answer(self, problem: Problem) -> dict[str, Any]:
        """Return the answer to the readings so far, the contents of follow.json.

        Of ``trace`` an entry is time, low end, median and high end of the goal's key, and the
        probabilities of laws; the first one before the test.

        Parameters
        ----------
        problem : of the running test, with its readings so far.
        """
        (test,), asked, follower = problem.experiments, self._asked, self._followers[""]
        times, end, window = test.times, test.case.time.end, test.case.time.end / WINDOWS
        laws_before, key = probabilities(self._evidences), problem.keys[asked.key]
        trace = [[0.0, *self._before[asked.key].tolist(), *laws_before.values()]]
        alarm, now = None, float(times.max())
        for number in range(1, WINDOWS):
            low, high = np.array([number, number + 1]) * window * (1.0 + 1e-9)
            old, new = times <= low, (times > low) & (times <= high)
            if high > now * (1.0 + 2e-9) or not old.any() or not new.any():
                continue
            entry, probability = self._window(problem, old, new)
            trace.append(entry)
            if probability < _IMPROBABLE:
                alarm = {"time": float(times[new].min()), "probability": probability}
                break
        counted = times < (np.inf if alarm is None else alarm["time"])
        part = part_of(test, counted)
        found = follower.update(part)
        laws, until = self._laws(problem, counted, found), float(times[counted].max())
        if len(trace) > 1 and trace[-1][0] >= until:
            del trace[-1]
        intervals = self._intervals(found)
        trace.append([until, *intervals[asked.key].tolist(), *laws.values()])
        self._last = found, part
        keys = self._keys(problem, intervals)
        percent = keys[key]["percent"]
        ratio = asked.percent / percent
        time, less = time_to_goal(follower, found, part, asked.key, ratio, until)
        depth = None
        if asked.depth is not None:
            reached = time_to(follower, found, asked.depth)
            when = TimeTo.of(reached, self._level)
            depth = {"depth": asked.depth, **when._asdict()}
        answer = {
            "test": test.name, "whom": asked.whom, "time": now, "end": end,
            "ended": now >= _ENDED * end, "readings": len(times), "level": self._level,
            "keys": keys, "depth": depth, "alarm": alarm, "trace": trace,
            "goal": {"key": key, "percent": asked.percent, "time": time, "at_end": percent * less},
            "draws": len(found.weights), "effective_count": found.effective,
            "redraws": found.redraws, "interpolated": follower.histories.error,
            "doubts": [*asked.doubts, *self._doubts(found)],
            "laws": {law or "this law": (laws_before[law], laws[law]) for law in laws},
        }  # fmt: skip
        return {**answer, "summary": lines_of(answer)}

    def _window(
        self, problem: Problem, old: BoolArray, new: BoolArray
    ) -> tuple[list[float], float]:
        """Return what old readings tell, and how probable new ones are by them."""
        (test,), follower = problem.experiments, self._followers[""]
        both = part_of(test, old | new)
        content = tuple(
            (s.name, s.x.tobytes(), s.value.tobytes(), s.sd.tobytes(), str(s.censored))
            for s in both.series
        )
        if content not in self._windows:
            found, last = follower.update(part_of(test, old)), test.times[old].max()
            laws = self._laws(problem, old, found)
            p = surprise(follower, found, both, both.times > last) if found.likelihood else 1.0
            interval = self._intervals(found)[self._asked.key].tolist()
            self._windows[content] = [float(last), *interval, *laws.values()], p
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

    def _intervals(self, found: Specimen) -> FloatArray:
        """Return low end, median and high end of each key, (m, 3)."""
        tail = 0.5 * (1.0 - self._level)
        columns = self._draws.values(found.unknowns[:, : len(self._draws.keys)]).T
        return np.array([quantiles(c, found.weights, (tail, 0.5, 1.0 - tail)) for c in columns])

    def _keys(self, problem: Problem, intervals: FloatArray) -> dict[str, dict[str, Any]]:
        """Return entries of the keys, as in fit.json, with the interval before the test."""
        keys, case = {}, problem.experiments[0].case
        units = dict(zip(self._draws.keys, self._draws.units, strict=True))
        for parameter, (low, median, high), (first, _, last) in zip(
            problem.parameters, intervals.tolist(), self._before.tolist(), strict=True
        ):
            entry = {
                "unit": units[parameter.key], "estimate": median, "interval": (low, high),
                "before": (first, last), "percent": 50.0 * (high - low) / abs(median),
            }  # fmt: skip
            told = in_users_unit(parameter, entry, case)
            keys[parameter.key] = entry if told is None else {**entry, "told": told}
        return keys

    def _doubts(self, found: Specimen) -> list[str]:
        doubts, histories = [], self._followers[""].histories
        if found.effective < _FEW:
            doubts.append(
                f"these readings leave only {found.effective:.0f} of {len(found.weights)} draws: "
                "intervals are rough; use more draws (--draws), and check that the earlier tests "
                "are of the same material and rig"
            )
        box = histories.emulator.box
        inside = box.inside(found.unknowns[:, : len(box.centre)])
        if found.weights @ (np.abs(inside) > _EDGE).any(axis=1) > _AT_EDGES:
            doubts.append(
                "this specimen is beyond almost all that the earlier tests let expect: intervals "
                "are cut off there; check that they are of the same material and rig"
            )
        if histories.error > _ROUGH:
            doubts.append(
                f"histories between draws are known to {100 * histories.error:.2g} % of their "
                "spread: a layer is worn through, or a threshold is reached, at some draws"
            )
        return doubts

    def record(self) -> Panel | None:
        """Return the panel of the first record of penetration, approach or torque."""
        (found, test), histories = self._last, self._followers[""].histories
        known = [
            record for quantity in ("penetration", "approach", "torque")
            for record in records(test.series) if record[0].quantity == quantity
        ]  # fmt: skip
        if not known or found.likelihood is None:
            return None
        (series, part), quantity = known[0], known[0][0].quantity
        steps = histories.at_steps(quantity.replace("penetration", "approach"))
        steps = steps - steps[0] if quantity == "penetration" else steps
        tail = 0.5 * (1.0 - self._level)
        curves = np.quantile(found.chosen(_DRAWN) @ steps.T, (tail, 0.5, 1.0 - tail), axis=0)
        middle = self._followers[""].middle(found, test)
        added = found.likelihood.likelihood.nuisance_draws(middle[None])[0][0]
        value = series.value - added[part]
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
