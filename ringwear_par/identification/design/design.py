"""``rw.design`` and ``ringwear design``: the next tests that tell most of the fitted keys.

The information of tests adds, nuisances of each being projected out, so that m + 1 histories a
candidate, at a few draws of what is known, tell what every combination of them would.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.files.folders import DESIGN, MAP, NEXT, check_folder
from ringwear_par.files.writing import announce_replacement, closing_line
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import Criterion, Problem
from ringwear_par.identification.design.candidates import (
    INSTANTS,
    LOADS,
    MOST_CANDIDATES,
    Candidate,
    candidates,
    count_of,
)
from ringwear_par.identification.design.information import Before, before_tests, informations
from ringwear_par.identification.design.search import Candidates, Design
from ringwear_par.identification.histories import Readings
from ringwear_par.parallel import on_first_rank
from ringwear_par.results.execution.stop_signals import StopSignals
from ringwear_par.results.result import Outcome
from ringwear_par.version import versions

Source = Path | str | Mapping[str, Any]
_ROOM = "ringwear_par.identification.design"


@dataclass(frozen=True, eq=False)
class DesignResult(Outcome):
    """The result of ``design``, with a fixed set of names in ``to_dict``."""

    functions: ClassVar = {
        "summary": f"{_ROOM}.design_numbers", "to_dict": f"{_ROOM}.design_numbers",
        "save": f"{_ROOM}.design_folder", "plot": f"{_ROOM}.design_numbers",
    }  # fmt: skip

    #: the fit
    problem: Problem
    #: what was compared
    every: Candidates
    #: the best ones, the best first
    designs: tuple[Design, ...]
    #: what is known without further tests, and after those of the fit file
    today: Design
    planned: Design
    #: (rows, count) numbers of tests that were compared together, the best first
    compared: IntArray
    #: folder of the earlier fit that counts, "" for none
    after: str
    #: tests that have no history, and why the first one has none
    failed: tuple[Candidate, ...]
    reason: str
    #: number of histories
    histories: int
    #: of the software
    versions: Mapping[str, str]

    def __repr__(self) -> str:
        tests = " + ".join(str(self.candidates[i].to_dict()) for i in self.designs[0].tests)
        return f"<DesignResult: {tests}>"

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """All tests (c,) that have histories."""
        return (*self.every.tests,)

    @property
    def nominal(self) -> FloatArray:
        """(m,) values of the keys, as they seem to be."""
        return self.every.before.values

    @property
    def single(self) -> FloatArray:
        """(c, m) predicted standard deviations after each of them alone."""
        return self.every.sds(self.every.information)


def design(
    source: Source,
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
    ComputationError : a test of the fit file has no history, or too few candidates have one.

    Examples
    --------
    >>> import ringwear_par as rw
    >>> best = rw.design("scripts/fit/plan.toml").designs[0]
    >>> len(best.tests)
    2
    """
    comm = MPI.COMM_WORLD if comm is None else comm

    def read() -> tuple[Problem, Before, list[Candidate]]:
        problem = read_fit(source, plans=True)
        if criterion is not None:
            problem = replace(problem, design=replace(problem.design, criterion=criterion))
        _check(problem)
        problem, before = before_tests(problem, None if after is None else Path(after))
        return problem, before, candidates(problem.design, problem.experiments[0])

    problem, before, tests = on_first_rank(comm, read)
    own = len(problem.experiments)
    whole = (*problem.experiments, *dict.fromkeys(test.experiment for test in tests))
    parts: list[tuple[int, Any]] = [(i, range(len(t.series))) for i, t in enumerate(whole[:own])]
    parts += [(whole.index(test.experiment), test.series) for test in tests]
    # signals are not waited for: there is nothing to keep
    readings = Readings(replace(problem, experiments=whole, alternatives={}), comm, StopSignals())

    def lead() -> DesignResult:
        information = informations(readings, before, own, parts)
        good = np.isfinite(information).all(axis=(1, 2, 3))
        if not good[:own].all():
            name = whole[int(np.argmin(good))].name
            raise ComputationError(f'{problem.name}: experiment "{name}": {readings.reason}')
        left = [test for test, has in zip(tests, good[own:], strict=True) if has]
        failed = tuple(test for test, has in zip(tests, good[own:], strict=True) if not has)
        space = problem.design
        shortest = min((test.seconds for test in left), default=np.inf)
        if shortest * space.experiments > space.time_limit:
            raise ComputationError(
                f"{problem.name}: design: {len(failed)} of {len(tests)} tests cannot be computed, "
                f"which leaves too few: {readings.reason}"
            )
        every = Candidates(problem, before, left, information[own:][good[own:]])
        compared = every.best(space.experiments)
        best = [
            every.design(every.information[compared[row]].sum(axis=0), compared[row].tolist())
            for row in every.listed(compared)
        ]
        today, planned = np.zeros_like(information[0]), information[:own].sum(axis=0)
        return DesignResult(
            problem, every, tuple(best), every.design(today), every.design(planned), compared,
            str(after or ""), failed, readings.reason, readings.count, versions(),
        )  # fmt: skip

    return readings.lead(lead)


def _check(problem: Problem) -> None:
    """Refuse designs that cannot be. Raises InputError."""
    space, name = problem.design, f"{problem.name}: design"
    if not space.ranges:
        raise InputError(
            f"{name}.vary: is missing or empty; must name what may differ between tests, as the "
            "range of load.pressure"
        )
    first = problem.experiments[0]
    for key in space.ranges:
        if key in problem.keys or (key in LOADS and {*LOADS} & {*problem.keys}):
            raise InputError(f"{name}.vary: {key}: is fitted as well; must be one or the other")
        if key in INSTANTS and not any(series.profile for series in first.series):
            raise InputError(
                f'{name}.vary: {key}: needs a profile in experiment "{first.name}", as which tests '
                "are measured"
            )
    end = first.case.time.end
    shortest = space.experiments * space.ranges.get("time.end", (end, end))[0]
    if shortest > space.time_limit:
        raise InputError(
            f"{name}.budget: time.end = {space.seconds:g}: must be at least {shortest:g}, "
            f"{space.experiments} of the shortest tests"
        )
    if (count := count_of(space)) > MOST_CANDIDATES:
        raise InputError(
            f"{name}.vary: makes {count} tests; must be at most {MOST_CANDIDATES}: fewer keys, or "
            "narrower load.steps or profiles"
        )


def run_design(
    source: Path,
    folder: Path,
    comm: MPI.Intracomm,
    *,
    after: Path | None = None,
    criterion: Criterion | None = None,
) -> None:
    """Find the next tests and write them to a folder. Collective on comm."""
    files = (DESIGN, NEXT, MAP)
    on_first_rank(comm, lambda: check_folder(folder, files, "fit"))
    result = design(source, comm, after=after, criterion=criterion)

    def save() -> None:
        announce_replacement(folder / DESIGN)
        result.save(folder)

    on_first_rank(comm, save)
    if comm.rank == 0:
        print(result.summary())
        print(closing_line(folder, files))
