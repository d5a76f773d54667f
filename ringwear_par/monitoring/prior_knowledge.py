"""What is known of a specimen before its test: from the fit of other tests."""

from dataclasses import dataclass, replace
from pathlib import Path

from mpi4py import MPI

from ringwear_par.errors import InputError, legible
from ringwear_par.files.folders import FIT
from ringwear_par.files.text import parse_json, read_text
from ringwear_par.history.derivatives.keys import is_elastic
from ringwear_par.identification.definition.problem import Problem, ProcessNoise
from ringwear_par.identification.fit import fit_problem
from ringwear_par.monitoring.running_test import NOT_KNOWN, RunningTest
from ringwear_par.parallel import on_first_rank
from ringwear_par.prediction.draws import NEXT
from ringwear_par.prediction.known import FitKnowledge, check_predicted, doubts_of, fit_knowledge


@dataclass(frozen=True, eq=False)
class FollowedTest:
    """A test that is followed, with what is known of its specimen before."""

    running: RunningTest
    #: of it alone, with the random wear that the fit knows
    problem: Problem
    #: before the test
    known: FitKnowledge
    #: whom that is about
    specimen: str

    @property
    def doubts(self) -> tuple[str, ...]:
        """Sentences about what speaks against the draws."""
        case = self.problem.experiments[0].case
        return tuple(doubt.text for doubt in doubts_of(self.known, case, self.specimen))

    def read(self) -> Problem:
        """Return the problem with the readings so far.

        Raises
        ------
        InputError : its faults; the file has other keys or another case than at the beginning.
        """
        problem, place = self.running.read(), f"{self.running.source}: "
        faults = []
        if problem.parameters != self.problem.parameters:
            faults.append(f"{place}fit.parameters: must stay as they were while a test is followed")
        if problem.experiments[0].case.text != self.problem.experiments[0].case.text:
            faults.append(
                f"{place}{legible(self.running.name)}: its case must stay as it was while the test "
                "is followed"
            )
        if faults:
            raise InputError(*faults)
        return replace(problem, settings=self.problem.settings)


def followed_test(running: RunningTest, after: Path | None, comm: MPI.Intracomm) -> FollowedTest:
    """Return a test with what is known before it. Collective.

    Parameters
    ----------
    after : folder of the fit of earlier tests; None: the other tests of the file are fitted.

    Raises
    ------
    InputError : the fit knows too little, or other things.
    ComputationError : of the fit.
    """
    if after is not None:
        return on_first_rank(
            comm, lambda: _followed_test(running, fit_knowledge(after), _tests_of(after))
        )
    fit = fit_problem(on_first_rank(comm, running.other_tests), comm)
    return on_first_rank(comm, lambda: _followed_test(running, fit_knowledge(fit), set()))


def _followed_test(running: RunningTest, known: FitKnowledge, tests: set[str]) -> FollowedTest:
    """Return a test with what a fit of tests knows before it. On one rank.

    Raises
    ------
    InputError : the fit knows too little, or other things.
    """
    problem, place = running.read(), f"{running.source}: {legible(running.name)}"
    (experiment,), values = problem.experiments, known.values
    if running.name in tests:
        raise InputError(
            f"{place}: is among the tests of {known.name}, so that its readings would count twice; "
            "must be followed after a fit without it"
        )
    if not len(values.scattering) and not values.sizes.any():
        raise InputError(f"{known.name}: {NOT_KNOWN}")
    if problem.keys != values.keys:
        raise InputError(
            f"{running.source}: fits {', '.join(problem.keys)}; must be {', '.join(values.keys)}, "
            f"as {known.name}"
        )
    if is_elastic(experiment.case, problem.keys):
        raise InputError(
            f"{running.source}: a modulus, a Poisson's ratio or a thickness is fitted; a test is "
            "followed with numbers of wear laws and friction only"
        )
    specimen = experiment.groups[0] or experiment.name
    specimen = specimen if specimen in values.specimens else NEXT
    check_predicted(known, experiment.case, place, specimen)
    # the size itself is drawn
    process = {
        f"wear.{body}": ProcessNoise(size=1.0)
        for body, sizes in zip(("lower", "upper"), values.sizes.T, strict=True)
        if sizes.any()
    }
    settings = replace(problem.settings, process=process)
    return FollowedTest(running, replace(problem, settings=settings), known, specimen)


def _tests_of(folder: Path) -> set[str]:
    """Return the names of the tests of a fit's folder."""
    if not (folder / FIT).is_file():  # told by who reads the fit
        return set()
    content = parse_json(read_text(folder / FIT))
    return set(content.get("experiments", {})) if isinstance(content, dict) else set()
