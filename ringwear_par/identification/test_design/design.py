"""``rw.design`` and ``ringwear design``: the next tests that tell most of the fitted keys.

The information of tests adds, nuisances of each being eliminated, so that the histories of all
candidates, one each, tell what every combination of them would. It is averaged over what the keys
may be: draws from an earlier fit or from priors.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.files.folders import DESIGN, MAP, NEXT, check_folder
from ringwear_par.files.writing import announce_replacement, closing_line
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import Criterion, Problem
from ringwear_par.identification.test_design.candidates import (
    INSTANTS,
    LOADS,
    MOST_CANDIDATES,
    Candidate,
    candidates,
    count_of,
)
from ringwear_par.identification.test_design.information import (
    PriorInformation,
    information_of_tests,
    prior_information,
    with_noise,
)
from ringwear_par.identification.test_design.search import Design, Search
from ringwear_par.parallel import on_first_rank
from ringwear_par.results.result import Outcome
from ringwear_par.version import versions

Source = Path | str | Mapping[str, Any]
_ROOM = "ringwear_par.identification.test_design"


@dataclass(frozen=True, eq=False)
class DesignResult(Outcome):
    """The result of ``design``, with a fixed set of names in ``to_dict``.

    Parameters
    ----------
    problem : the fit.
    candidates : all tests.
    single : (c, m) predicted standard deviations after each candidate alone.
    single_scores : (c,) of each alone.
    designs : the best ones, the best first.
    planned : what the experiments of the fit file tell by themselves.
    nominal : (m,) values of the keys, as they seem to be.
    information : (m, m) of the unknowns, known before.
    draws : how many values of the keys were looked at.
    after : the earlier fit whose information counts, "" for none.
    pairs, pair_scores : of two tests: (c, c, m) predicted standard deviations, and (c, c) scores;
        empty otherwise.
    failed : candidates whose histories fail, and why.
    histories : computed.
    versions : of the software.
    """

    functions: ClassVar = {
        "summary": f"{_ROOM}.design_numbers", "to_dict": f"{_ROOM}.design_numbers",
        "save": f"{_ROOM}.design_folder", "plot": f"{_ROOM}.design_numbers",
    }  # fmt: skip

    problem: Problem
    candidates: tuple[Candidate, ...]
    single: FloatArray
    single_scores: FloatArray
    designs: tuple[Design, ...]
    planned: Design
    nominal: FloatArray
    information: FloatArray
    draws: int
    after: str
    pairs: FloatArray
    pair_scores: FloatArray
    failed: Mapping[Candidate, str]
    histories: int
    versions: Mapping[str, str]

    def __repr__(self) -> str:
        tests = " + ".join(str(self.candidates[i].to_dict()) for i in self.designs[0].tests)
        return f"<DesignResult: {tests}>"

    @property
    def criterion(self) -> Criterion:
        """The criterion by which designs were compared."""
        return self.problem.design.criterion


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
    after : folder of an earlier fit of the same keys, whose information counts.
    criterion : instead of the file's.

    Returns
    -------
    DesignResult : ``.designs``, the best first, ``.summary()``, ``.save(folder)``.

    Raises
    ------
    InputError : all faults of the file and its data, or of the earlier fit.
    ComputationError : a history of a candidate.

    Examples
    --------
    >>> import ringwear_par as rw
    >>> best = rw.design("scripts/fit/plan.toml").designs[0]
    >>> len(best.tests)
    2
    """
    comm = MPI.COMM_WORLD if comm is None else comm

    def read() -> tuple[Problem, PriorInformation, tuple[Candidate, ...]]:
        problem = read_fit(source, plans=True)
        if criterion is not None:
            problem = replace(problem, design=replace(problem.design, criterion=criterion))
        prior = prior_information(problem, after)
        problem = with_noise(problem, prior)
        _check(problem, prior)
        return problem, prior, tuple(candidates(problem.design, problem.experiments[0]))

    problem, prior, tests = on_first_rank(comm, read)
    information_of_file, failures, more = information_of_tests(
        problem, problem.experiments, prior.draws, prior.scatter, comm
    )
    if failures:
        number, reason = min(failures.items())
        raise ComputationError(
            f'{problem.name}: experiment "{problem.experiments[number].name}": {reason}'
        )
    experiments = [test.experiment for test in tests]
    information, failures, histories = information_of_tests(
        problem, experiments, prior.draws, prior.scatter, comm
    )
    left = [number for number in range(len(tests)) if number not in failures]
    shortest = min((tests[number].seconds for number in left), default=np.inf)
    space = problem.design
    if not left or shortest * space.experiments > space.time_limit:
        reason = next(iter(failures.values()), "")
        raise ComputationError(
            f"{problem.name}: design: {len(failures)} of {len(tests)} tests cannot be computed, "
            f"which leaves too few: {reason}"
        )
    search = Search(problem, prior, information[:, left], [tests[number] for number in left])
    best = search.best(space.experiments)
    pairs, scores = search.pairs() if space.experiments == 2 else (np.zeros((0, 0, 0)),) * 2
    single, single_scores = search.singles()
    failed = {tests[number]: reason for number, reason in failures.items()}
    return DesignResult(
        problem, tuple(tests[number] for number in left), single, single_scores,
        tuple(best), search.design_of_file(information_of_file), prior.nominal, prior.information,
        len(prior.draws), prior.after, pairs, scores, failed, histories + more, versions(),
    )  # fmt: skip


def _check(problem: Problem, prior: PriorInformation) -> None:
    """Refuse designs that cannot be. Raises InputError."""
    space, name = problem.design, f"{problem.name}: design"
    if space.criterion == "eig" and not prior.whole:
        raise InputError(
            f'{name}: criterion = "eig": needs something that is known before, a prior of every '
            "parameter or an earlier fit (--after)"
        )
    if not space.ranges:
        raise InputError(
            f"{name}.vary: is missing or empty; must name what may differ between tests, as the "
            "range of load.pressure"
        )
    for key in space.ranges:
        if key in problem.keys or (key in LOADS and set(LOADS) & set(problem.keys)):
            raise InputError(f"{name}.vary: {key}: is fitted as well; must be one or the other")
    first = problem.experiments[0]
    for key in INSTANTS:
        if key in space.ranges and not any(series.profile for series in first.series):
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
