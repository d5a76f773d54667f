"""The outcome of a measurement: numbers of tests, repeats."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.cases.units import CUSTOMARY, SPECIFIC, factor
from ringwear_par.errors import warning_lines
from ringwear_par.files.folders import MEASURE, MEASURED_ROWS, RECORDS, json_bytes, write_outcome
from ringwear_par.measuring.analysis.budget import Estimate, WholeTest
from ringwear_par.measuring.analysis.numbers import (
    PSI_FT_MIN,
    TestNumbers,
    friction_readings,
)
from ringwear_par.measuring.analysis.repeats import Repeats
from ringwear_par.measuring.definition.problem import Problem
from ringwear_par.measuring.measure_numbers import lines_of, repeats_text, table
from ringwear_par.results.result import Outcome

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: most readings of a channel that figures draw
_MOST_READINGS = 1000
#: 1 mm/s in um/h and in in/h
UM_PER_H, IN_PER_H = 3.6e6, 3600.0 / 25.4


@dataclass(frozen=True, eq=False)
class MeasureResult(Outcome):
    """The numbers of the standards of some tests, with a fixed set of names in ``to_dict``.

    Parameters
    ----------
    problem : the measure file with its records.
    tests : in its order.
    repeats : tests of the same conditions.
    versions : of the software.
    """

    problem: Problem
    tests: tuple[TestNumbers, ...]
    repeats: tuple[Repeats, ...]
    versions: Mapping[str, str]

    def __repr__(self) -> str:
        rates = ", ".join(
            f"{test.name} {test.specific_wear_rate.value:.4g}"
            for test in self.tests
            if test.specific_wear_rate is not None
        )
        return f"<MeasureResult: specific wear rates in mm3/(N m): {rates or 'none'}>"

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of measure.json."""
        return {
            "tests": {test.name: _test(test) for test in self.tests},
            "repeats": [repeats.to_dict() for repeats in self.repeats],
            "notes": list(self.problem.notes),
            "mass_sd": self.problem.mass_sd,
            "steady_limits": {
                "wear": self.problem.limits.wear, "friction": self.problem.limits.friction,
                "from": self.problem.limits.start,
            },
            "measure_file": self.problem.text,
            "versions": dict(self.versions),
            "data": dict(self.problem.hashes),
        }  # fmt: skip

    def summary(self) -> str:
        """Return the outcome as the command prints it."""
        outcome = self.to_dict()
        tests: Mapping[str, Any] = outcome["tests"]
        lines = [f"specific wear rate {repeats_text(repeats)}" for repeats in outcome["repeats"]]
        if not lines:
            these = "this specimen" if len(tests) == 1 else f"these {len(tests)} specimens"
            lines.append(f"numbers of {these} only: repeats of a material scatter more")
        width = max(map(len, tests))
        for name, entry in tests.items():
            for number, line in enumerate(lines_of(entry)):
                lines.append(f"{'' if number else name:{width}}  {line}")
        lines += [f"note: {note}" for note in outcome["notes"]]
        doubts = [f"{name}: {d['text']}" for name, entry in tests.items() for d in entry["doubts"]]
        return "\n".join([*lines, *warning_lines(doubts)])

    def save(self, path: str | Path) -> None:
        """Write the files of its folder, see ``Outcome.save``."""
        from ringwear_par.pictures.style import picture

        contents: dict[str, Callable[[], bytes | None]] = {
            RECORDS: lambda: picture(self.plot, str(Path(path) / RECORDS)),
            MEASURED_ROWS: lambda: table(self.to_dict()).encode(),
            MEASURE: lambda: json_bytes(self.to_dict()),
        }
        write_outcome(Path(path), "measure", contents)

    def plot(self) -> "Figure":
        """Return the figure of its records: depth and friction of each test."""
        from ringwear_par.measuring.figures import plot

        return plot(self.to_dict()["tests"])


def _test(numbers: TestNumbers) -> dict[str, Any]:
    test, part, conditions = numbers.test, numbers.part, numbers.conditions
    record = test.record
    ring = test.case.upper if test.body == "upper" else test.case.lower
    entry: dict[str, Any] = {
        "steady": part.steady,
        "steady_from": {"value": part.start, "wear": part.wear, "friction": part.friction},
        "of": part.of,
        "friction": _entry(numbers.friction),
        "wear_rate": _wear_rate(numbers.wear_rate),
        "specific_wear_rate": _specific(numbers.specific_wear_rate),
        "autocorrelation": numbers.autocorrelation,
        "pv": {"MPa m/s": conditions.pv, "psi ft/min": conditions.pv * PSI_FT_MIN},
        "whole": _whole(numbers.whole),
        "conditions": {
            "force": conditions.force, "pressure": conditions.pressure, "omega": conditions.omega,
            "speed": conditions.speed, "area": conditions.area, "mean_radius": conditions.radius,
            "radii": [conditions.inner, conditions.outer], "body": test.body,
            "density": ring.density,
        },
        "temperature": None
        if numbers.temperature is None
        else {"mean": numbers.temperature[0], "max": numbers.temperature[1], "unit": "degC"},
        "channels": _channels(numbers),
        "duration": test.duration,
        "end": record.end,
        "file": record.file,
        "columns": dict(record.columns),
        "skipped": {
            "empty": record.empty, "repeated": record.repeated, "excluded": record.excluded,
        },
        "doubts": [doubt.to_dict() for doubt in numbers.doubts],
        "notes": list(numbers.notes),
    }  # fmt: skip
    return entry


def _channels(numbers: TestNumbers) -> dict[str, dict[str, list[float]]]:
    """Return the readings of wear (mm) and friction, thinned where they are many, and their means.

    Times are in s.
    """
    record, channels = numbers.test.record, {}
    for name, readings, blocks in (
        ("wear", record.wear, numbers.wear_blocks),
        ("friction", friction_readings(numbers.test), numbers.friction_blocks),
    ):
        if readings is not None and blocks is not None:
            rows = np.flatnonzero(np.isfinite(readings))
            rows = rows[:: -(-len(rows) // _MOST_READINGS)]
            channels[name] = {
                "time": record.time[rows].tolist(), "readings": readings[rows].tolist(),
                "block_time": blocks.time.tolist(), "block_means": blocks.value.tolist(),
            }  # fmt: skip
    return channels


def _entry(estimate: Estimate | None) -> dict[str, Any] | None:
    return None if estimate is None else {**estimate.to_dict(), "of": "specimen"}


def _wear_rate(rate: Estimate | None) -> dict[str, Any] | None:
    if rate is None:
        return None
    return {
        **rate.to_dict(), "of": "specimen", "um/h": rate.value * UM_PER_H,
        "in/h": rate.value * IN_PER_H,
    }  # fmt: skip


def _specific(rate: Estimate | None) -> dict[str, Any] | None:
    if rate is None:
        return None
    customary = rate.scaled(factor(SPECIFIC, None) / factor(CUSTOMARY, None), CUSTOMARY)
    return {
        **rate.to_dict(), "of": "specimen", CUSTOMARY: customary.value,
        "us": {"unit": CUSTOMARY, "value": customary.value, "u": customary.u,
               "interval": list(customary.interval)},
    }  # fmt: skip


def _whole(whole: WholeTest) -> dict[str, Any]:
    return {
        "distance": {"value": whole.distance, "unit": "m"},
        "mass_loss": _entry(whole.mass_loss),
        "volume": _entry(whole.volume),
        "specific_wear_rate": _specific(whole.specific_wear_rate),
        "volume_by_displacement": _entry(whole.volume_by_displacement),
    }
