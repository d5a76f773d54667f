"""The numbers of one test: friction, wear rates, what the balance says; and doubts about them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.units import SPECIFIC
from ringwear_par.errors import ValidityWarning
from ringwear_par.measuring.analysis import steady_part
from ringwear_par.measuring.analysis.budget import (
    Estimate,
    Source,
    WholeTest,
    displaced_volume,
    load_sources,
    source_of,
    whole_test,
)
from ringwear_par.measuring.definition.problem import Conditions, Problem, Test, Uncertainty
from ringwear_par.measuring.definition.records import Record
from ringwear_par.schedules import in_time

#: 1 MPa m/s in psi ft/min
PSI_FT_MIN = 145.0377377 * 196.8503937
RATE = "mm/s"
#: share by which volumes may differ whatever their uncertainties; most blocks of a gap; share of
#: the test below which a steady part is short; share by which loads may differ
_DIFFERENT, _GAP, _SHORT, _OTHER_LOAD = 0.05, 10.0, 0.3, 0.02
#: range of friction coefficients of sliding contacts, lubricated or dry; ratio of volumes above
#: which one was read in another unit
_FRICTIONS, _OTHER_UNIT = (0.002, 3.0), 300.0


@dataclass(frozen=True, eq=False)
class TestNumbers:
    """The numbers of a test."""

    #: pytest looks for classes that are called so
    __test__ = False

    test: Test
    #: that friction and rates are of
    part: steady_part.SteadyPart
    #: means over the part
    conditions: Conditions
    #: block means of the depth, mm, and of the friction coefficient
    wear_blocks: steady_part.Blocks | None
    friction_blocks: steady_part.Blocks | None
    #: the coefficient; None: not read, as of the rates
    friction: Estimate | None
    #: mm/s
    wear_rate: Estimate | None
    #: mm3/(N m)
    specific_wear_rate: Estimate | None
    #: of the blocks of the depth, or of the friction where there is none
    autocorrelation: float
    whole: WholeTest
    #: degC, mean and largest of the part
    temperature: tuple[float, float] | None
    doubts: tuple[ValidityWarning, ...]
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        numbers = {
            "specific wear rate": self.specific_wear_rate, "wear rate": self.wear_rate,
            "friction": self.friction,
        }  # fmt: skip
        known = (f"{name} {number!r}" for name, number in numbers.items() if number is not None)
        return f"<TestNumbers {self.name}, of the {self.part.of}: {', '.join(known)}>"

    @property
    def name(self) -> str:
        """The name of the test."""
        return self.test.name


def numbers_of(test: Test, problem: Problem) -> TestNumbers:
    """Return the numbers of a test, with their budgets and doubts."""
    record, limits, known = test.record, problem.limits, problem.uncertainty
    wear = None if record.wear is None else steady_part.block_means(record.time, record.wear)
    coefficient = friction_readings(test)
    friction = None if coefficient is None else steady_part.block_means(record.time, coefficient)
    part = steady_part.steady_part(
        wear, friction, record.end, wear_limit=limits.wear, friction_limit=limits.friction,
        start=limits.start,
    )  # fmt: skip
    conditions = test.conditions(part.start, record.end)
    estimates: dict[str, Estimate] = {}
    changes: list[steady_part.Change] = []
    if wear is not None:
        changes.append(change := steady_part.change_from(wear, part.start, 2))
        estimates["rate"] = _rate(change, known)
        estimates["specific"] = _specific(estimates["rate"], conditions, known)
    if friction is not None:
        changes.append(change := steady_part.change_from(friction, part.start, 1))
        estimates["friction"] = _friction(change, conditions, known)
    volume = None if wear is None else displaced_volume(wear, changes[0], test, known)
    whole = whole_test(test, problem, volume)
    result = TestNumbers(
        test, part, conditions, wear, friction, estimates.get("friction"), estimates.get("rate"),
        estimates.get("specific"), changes[0].autocorrelation, whole,
        _temperature(record.time, record.temperature, part.start), (), (),
    )  # fmt: skip
    return replace(result, doubts=tuple(_doubts(result, problem)), notes=tuple(_notes(result)))


def coverage_fault(test: Test, start: float | None) -> str:
    """Return the fault of a record with too few readings where they are needed, "" for none.

    Parameters
    ----------
    start : s, of the steady part where a user says it.
    """
    time = test.record.time
    first = steady_part.LAST_THIRD * test.record.end if start is None else start
    channels = {"wear": test.record.wear, "torque": friction_readings(test)}
    for name, readings in channels.items():
        if readings is None or steady_part.has_blocks(
            steady_part.block_means(time, readings), first
        ):
            continue
        return (
            f'test "{test.name}": {test.record.file}: readings of {name} are too unevenly spread '
            f"over {_hours(test.record.end)}; must be in at least "
            f"{steady_part.FEWEST_BLOCKS} equal parts of the record, and at its end; exclude the "
            "readings before or after a long gap"
        )
    return ""


def friction_readings(test: Test) -> FloatArray | None:
    """Return the friction coefficient, (n,): torque over the force and the mean radius."""
    if test.record.torque is None:
        return None
    force = in_time(test.force, test.record.time)
    radius = test.conditions(0.0, test.duration).radius
    pressed = np.where(force > 0.0, force * radius, np.nan)  # nothing rubs without a load
    return np.asarray(test.record.torque / pressed)


def _rate(change: steady_part.Change, known: Mapping[str, Uncertainty]) -> Estimate:
    """Return the wear rate in mm/s."""
    rate = change.value
    sources = [
        Source("readings", "A", change.value_u, RATE, 1.0),
        Source("steadiness", "B", change.steadiness_u, RATE, 1.0),
        *source_of(known, "displacement", 1.0, "1", rate),
        *source_of(known, "time", 1.0, "1", -rate),
    ]
    return Estimate(rate, RATE, tuple(sources))


def _specific(rate: Estimate, conditions: Conditions, known: Mapping[str, Uncertainty]) -> Estimate:
    """Return the specific wear rate in mm3/(N m): the rate over p V."""
    scaled = rate.scaled(1.0 / conditions.pv, SPECIFIC)
    k = scaled.value
    loads = [
        *load_sources(known, conditions, -k),
        *source_of(known, "load.omega", conditions.omega, "rad/s", -k / conditions.omega),
    ]
    return replace(scaled, sources=(*scaled.sources, *loads))


def _friction(
    change: steady_part.Change, conditions: Conditions, known: Mapping[str, Uncertainty]
) -> Estimate:
    """Return the friction coefficient."""
    mu = change.value
    torque = mu * conditions.force * conditions.radius
    sources = [
        Source("readings", "A", change.value_u, "1", 1.0),
        Source("steadiness", "B", change.steadiness_u, "1", 1.0),
        *source_of(known, "torque", torque, "N mm", 1.0 / (conditions.force * conditions.radius)),
        *load_sources(known, conditions, -mu),
    ]
    return Estimate(mu, "1", tuple(sources))


def _temperature(
    time: FloatArray, temperature: FloatArray | None, start: float
) -> tuple[float, float] | None:
    """Return the mean and the largest temperature from a start on, None where none was read."""
    if temperature is None:
        return None
    read = temperature[(time >= start) & np.isfinite(temperature)]
    return (float(read.mean()), float(read.max())) if len(read) else None


def _doubts(numbers: TestNumbers, problem: Problem) -> list[ValidityWarning]:
    """Return the doubts about the numbers of a test."""
    part, record, doubts = numbers.part, numbers.test.record, []
    if not part.steady:
        never = [
            f"no late part of the record shows for certain that {subject} changes by at most "
            f"{100 * limit:g} %"
            if steady_part.has_starts(blocks)
            else f"the record has too few readings to show that {subject} is steady"
            for subject, limit, blocks, start in (
                ("the wear rate", problem.limits.wear, numbers.wear_blocks, part.wear),
                ("friction", problem.limits.friction, numbers.friction_blocks, part.friction),
            )
            if blocks is not None and start is None
        ]
        text = f"not steady: {' and '.join(never)}; numbers are of the last third"
        doubts.append(ValidityWarning("not-steady", text))
    else:
        share = 1.0 - part.start / record.end
        if share < _SHORT:
            text = f"the steady part is only {100 * share:.0f} % of the test; test for longer"
            doubts.append(ValidityWarning("steady-part-short", text))
    depths = np.zeros(0) if record.wear is None else record.wear[record.time >= part.start]
    if len(depths) and np.nanmin(depths) == np.nanmax(depths):
        text = (
            f"{record.columns['wear']} stands still from {_hours(part.start)} on: is the sensor at "
            "its end? exclude leaves out a part of the record"
        )
        doubts.append(ValidityWarning("stands-still", text))
    friction, (low, high) = numbers.friction, _FRICTIONS
    if friction is not None and not low <= abs(friction.value) <= high:
        text = (
            f"friction {friction.value:.3g} is far from those of sliding contacts ({low:g} to "
            f"{high:g}): look at the unit of the torque, and at the force"
        )
        doubts.append(ValidityWarning("implausible-friction", text))
    whole = numbers.whole
    if (
        whole.volume is not None
        and whole.volume_by_displacement is not None
        and record.has_both_ends
    ):
        balance, depth = whole.volume, whole.volume_by_displacement
        difference = abs(balance.value - depth.value)
        if difference > max(2.0 * np.hypot(balance.u, depth.u), _DIFFERENT * abs(balance.value)):
            ratio = abs(depth.value / balance.value) if balance.value else 1.0
            look = "for thermal growth of the rings, debris or drift"
            if not 1.0 / _OTHER_UNIT < ratio < _OTHER_UNIT:
                look = "at their units"
            text = (
                f"over the whole test the displacement gives {depth.value:.4g} mm3 and the balance "
                f"{balance.value:.4g} mm3: look {look}"
            )
            doubts.append(ValidityWarning("displacement-against-weighing", text))
    before = problem.tests[: problem.tests.index(numbers.test)]
    for earlier in before:
        if earlier.record.sha256 == record.sha256:
            text = f"{earlier.record.file} and {record.file} are the same file: no repeats"
            doubts.append(ValidityWarning("same-file", text))
    return doubts + _gaps(record)


def _gaps(record: Record) -> list[ValidityWarning]:
    """Return doubts about the longest time without readings of a channel, of one that is long.

    What is excluded is no gap.
    """
    channels: dict[tuple[float, float], list[str]] = {}
    for channel, readings in (("displacement", record.wear), ("torque", record.torque)):
        if readings is None:
            continue
        read = record.time[np.isfinite(readings)]
        times = np.concatenate([[0.0], read, [record.duration]])
        counted = record.without_excluded(times)
        steps = np.diff(counted)
        longest = int(np.argmax(steps))
        if steps[longest] > _GAP * counted[-1] / steady_part.count_blocks(len(read)):
            gap = float(steps[longest]), float(times[longest])
            channels.setdefault(gap, []).append(channel)
    return [
        ValidityWarning(
            "gap", f"no readings of {' and '.join(names)} for {_hours(gap)} from {_hours(start)} on"
        )
        for (gap, start), names in channels.items()
    ]


def _notes(numbers: TestNumbers) -> list[str]:
    """Return sentences about how the record was read and where budgets disagree."""
    record = numbers.test.record
    notes = [*record.notes]
    if record.falling:
        column = record.columns["wear"]
        notes.append(f"{column} falls in total: taken as a position, whose fall is the wear")
    if record.load is not None and np.isfinite(record.load).any():
        read = np.isfinite(record.load)
        measured = float(record.load[read].mean())
        force = float(in_time(numbers.test.force, record.time[read]).mean())
        if abs(measured - force) > _OTHER_LOAD * force:
            notes.append(
                f"{record.columns['load']} is {measured:.4g} N on average, the case has "
                f"{force:.4g} N; numbers are computed with the force of the case"
            )
    rate = numbers.whole.specific_wear_rate
    if rate is not None and rate.shortest is not None and not rate.agrees:
        low, high = rate.shortest
        notes.append(
            f"GUM (from {rate.interval[0]:.4g} to {rate.interval[1]:.4g}) and Monte Carlo (from "
            f"{low:.4g} to {high:.4g} {SPECIFIC}) differ by more than a tenth of U; take the "
            "latter"
        )
    if numbers.friction is not None and numbers.friction.value < 0.0:
        notes.append(f"{record.columns['torque']} is negative, and so is friction")
    if numbers.wear_rate is not None and numbers.wear_rate.value <= 0.0:
        notes.append(
            "the wear rate is not positive: the depth does not grow in this part of the test"
        )
    return notes


def _hours(seconds: float) -> str:
    return f"{seconds / 3600.0:.3g} h"
