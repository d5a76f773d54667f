"""``rw.design`` and ``ringwear design``: the next tests that tell most of the fitted keys.

The information of tests adds, nuisances of each being projected out, so that m + 1 histories a
candidate, at a few draws of what is known, tell what every combination of them would.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.errors import ComputationError, InputError, counted
from ringwear_par.files.folders import BARS, DESIGN, POSTERIOR, json_bytes, write_outcome
from ringwear_par.identification.definition.fit_file import LOADS, read_fit
from ringwear_par.identification.definition.problem import Criterion, Experiment, Problem
from ringwear_par.identification.design.information import (
    Before,
    before_tests,
    candidates,
    in_users_units,
    informations,
    sds_in_words,
)
from ringwear_par.identification.draws import read_draws
from ringwear_par.identification.fit import into_folder
from ringwear_par.identification.histories import Readings
from ringwear_par.parallel import on_first_rank
from ringwear_par.pictures.key_panels import design_panels
from ringwear_par.pictures.matplotlib import panel_figure
from ringwear_par.pictures.style import picture
from ringwear_par.results.progress import StopSignals
from ringwear_par.results.result import Outcome
from ringwear_par.version import versions

#: designs that are listed, and shown by a summary
_LISTED, _SHOWN = 10, 5
#: inches: width and height of a panel, height of a test of a design in bars
_WIDTH, _HEIGHT, _LINE = 4.6, 4.2, 0.2
_CRITERIA = {"D": "smallest volume of the confidence ellipsoid (D)",
             "A": "smallest mean variance over the widths of the bounds (A)"}  # fmt: skip


@dataclass(frozen=True, eq=False)
class DesignResult(Outcome):
    """The result of ``design``: the best of all tests that could be made."""

    #: of design.json
    content: Mapping[str, Any]

    @property
    def designs(self) -> list[dict[str, Any]]:
        """The best designs that differ in more than durations, the best first.

        ``name``, ``experiments`` (keys of each test), ``seconds``, ``gain`` in bits (one bit halves
        one sd), and predicted standard deviations ``sd`` by key, None where it is not identified.
        """
        designs: list[dict[str, Any]] = self.content["designs"]
        return designs

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of design.json."""
        return dict(self.content)

    def summary(self) -> str:
        """Return the outcome in a few lines."""
        content = self.content
        where = f"after {content['after']}" if content["after"] else "at the start"
        valid = "without priors or an earlier fit (--after) it holds there only"
        if content["draws"] > 1:
            valid = f"means over {content['draws']} draws"
        lines = [
            f"{content['fit']}: {len(self.designs[0]['experiments'])} of {content['candidates']} "
            f"tests, {_CRITERIA[content['criterion']]}; measured as in {content['measured_as']}; "
            f"{content['histories']} histories",
            f"{where}: {', '.join(content['about'])}; {valid}",
        ]
        rows = [content["today"], *self.designs[:_SHOWN]]
        width = max(len(row["name"]) for row in rows)
        for row in rows:
            words = sds_in_words(row["sd"], content["sd_scales"])
            words += [f"gain {row['gain']:.3g} bits"] * (row["name"] != "today")
            lines.append(f"  {row['name'].ljust(width)}  {'; '.join(words)}")
        if content["failed"]:
            tests = counted(content["failed"], "test")
            lines.append(f"{tests} without a history are left out: {content['reason']}")
        return "\n".join(lines)

    def plot(self) -> Figure:
        """Return bars of the predicted standard deviations of the best designs."""
        panels = design_panels(self.content)
        lines = sum(len(entry["experiments"]) for entry in self.designs)
        return panel_figure([panels], (_WIDTH * len(panels), max(_HEIGHT, _LINE * lines)))

    def save(self, path: str | Path) -> None:
        """Write both files into a folder, see ``write_outcome``."""
        contents = {
            BARS: lambda: picture(self.plot, str(Path(path, BARS))),
            DESIGN: lambda: json_bytes(self.content),
        }
        write_outcome(Path(path), "fit", contents)


def design(
    source: Path | str | Mapping[str, Any],
    comm: MPI.Intracomm | None = None,
    *,
    after: str | Path | None = None,
    criterion: Criterion | None = None,
) -> DesignResult:
    """Return the tests that would tell most of the fitted keys, from ``[design]`` of a fit file.

    Collective on comm, the world's where none is given; the same on all ranks.

    Parameters
    ----------
    source : the name of a fit file, or the same as a dict.
    after : folder of an earlier fit of the same keys, whose draws tell what is known.
    criterion : "D" or "A", instead of the file's.

    Returns
    -------
    DesignResult : ``.designs``, the best first, ``.summary()``, ``.save(folder)``.

    Raises
    ------
    InputError : all faults of the file and its data, or of the earlier fit.
    ComputationError : too few candidates have a history.

    Examples
    --------
    >>> import ringwear_par as rw
    >>> best = rw.design("scripts/fit/plan.toml").designs[0]
    >>> len(best["experiments"])
    2
    """
    comm = MPI.COMM_WORLD if comm is None else comm

    def read() -> tuple[Problem, Before, tuple[Experiment, ...]]:
        problem = read_fit(source, plans=True)
        if criterion is not None:
            problem = replace(problem, design=replace(problem.design, criterion=criterion))
        _check(problem)
        draws = None if after is None else read_draws(Path(after, POSTERIOR))
        problem = problem if draws is None else draws.ordered(problem)
        tests = candidates(problem.design, problem.experiments[0])
        return problem, before_tests(problem, draws), tests

    problem, before, tests = on_first_rank(comm, read)
    # signals are not waited for: there is nothing to keep
    readings = Readings(replace(problem, experiments=tests), comm, StopSignals())

    def lead() -> DesignResult:
        information = informations(readings, before)
        good = np.isfinite(information).all(axis=(1, 2, 3))
        left = [test for test, has in zip(tests, good, strict=True) if has]
        found = _designs(problem, before, left, information[good]) if left else []
        if len(found) < 2:
            raise ComputationError(
                f"{problem.name}: design: {(~good).sum()} of {len(tests)} tests cannot be "
                f"computed, which leaves too few: {readings.reason}"
            )
        about, scales = in_users_units(problem, before)
        return DesignResult({
            "fit": problem.name, "criterion": problem.design.criterion,
            "after": None if after is None else str(after),
            "parameters": dict(zip(problem.keys, before.values.tolist(), strict=True)),
            "about": about, "draws": len(np.unique(before.draws, axis=0)),
            "candidates": len(left), "failed": len(tests) - len(left),
            "reason": readings.reason or None, "histories": readings.count,
            "measured_as": problem.experiments[0].name, "sd_scales": scales, "today": found[0],
            "designs": found[1:], "versions": versions(),
        })  # fmt: skip

    return readings.lead(lead)


def _designs(
    problem: Problem, before: Before, tests: Sequence[Experiment], information: FloatArray
) -> list[dict[str, Any]]:
    """Return no test, and the best ones by what all tell, (c, d, m, m), see ``informations``.

    All of one or two tests are looked at; to the best pair, further ones are added one by one.
    """
    count, every = problem.design.experiments, np.arange(len(tests))
    seconds = np.array([test.case.time.end for test in tests])
    low, high = problem.unknown_bounds

    def scores(rows: IntArray) -> FloatArray:
        """Return the score (rows,) of tests (rows, some) together; -inf beyond the time."""
        gain, sd = before.then(sum(information[column] for column in rows.T))
        score = gain if problem.design.criterion == "D" else -np.square(sd / (high - low)).mean(-1)
        left = (count - rows.shape[1]) * seconds.min()
        within = seconds[rows].sum(axis=1) + left <= problem.design.seconds
        return np.where(within, score, -np.inf)

    rows = every[:, None] if count == 1 else np.column_stack(np.triu_indices(len(every)))
    while rows.shape[1] < count:
        best = rows[scores(rows).argmax()]
        rows = np.column_stack([np.tile(best, (len(every), 1)), every])
    # designs that differ in more than durations, where anything else varies
    kinds = [
        [v for key, v in t.changes.items() if key != "time.end"] or t.case.time.end for t in tests
    ]
    chosen, found = dict[str, list[int]]({"": []}), scores(rows)
    for row in np.argsort(-found, kind="stable").tolist():
        if len(chosen) > _LISTED or found[row] == -np.inf:
            break
        chosen.setdefault(str(sorted(kinds[i] for i in rows[row])), rows[row].tolist())
    return [
        {
            "name": " + ".join(tests[i].name for i in some) or "today",
            "experiments": [dict(tests[i].changes) for i in some],
            "seconds": float(seconds[some].sum()),
            "gain": float(before.then(told)[0] / np.log(2.0)),
            "sd": before.sds(told),
        }
        for some in chosen.values()
        for told in [information[some].sum(axis=0)]
    ]


def _check(problem: Problem) -> None:
    """Refuse designs that cannot be. Raises InputError."""
    space, name = problem.design, f"{problem.name}: design"
    if not space.ranges:
        raise InputError(
            f"{name}.vary: is missing or empty; must name what may differ between tests, as the "
            "range of load.pressure"
        )
    for key in space.ranges:
        if key in problem.keys or (key in LOADS and {*LOADS} & {*problem.keys}):
            raise InputError(f"{name}.vary: {key}: is fitted as well; must be one or the other")
    end = problem.experiments[0].case.time.end
    shortest = space.experiments * space.ranges.get("time.end", (end, end))[0]
    if shortest > space.seconds:
        raise InputError(
            f"{name}.budget: time.end = {space.seconds:g}: must be at least {shortest:g}, "
            f"{space.experiments} of the shortest tests"
        )


def run_design(
    source: Path,
    folder: Path,
    comm: MPI.Intracomm,
    *,
    after: Path | None = None,
    criterion: Criterion | None = None,
) -> None:
    """Find the next tests as ``design`` does and write them to a folder. Collective on comm."""
    job = partial(design, source, comm, after=after, criterion=criterion)
    into_folder(folder, (DESIGN, BARS), comm, job)
