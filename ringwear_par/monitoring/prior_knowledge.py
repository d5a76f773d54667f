"""What is known of a specimen before its test: from the fit of other tests."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from mpi4py import MPI

from ringwear_par.errors import InputError, legible, reason_of
from ringwear_par.files.folders import FIT
from ringwear_par.files.text import read_text
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
    #: why there is no probability of a law that the fit compared, by name
    not_compared: Mapping[str, str]

    @property
    def log_evidences(self) -> dict[str, float]:
        """Logarithms of the fit's evidences of the laws compared, "" for its own; or none."""
        laws = self.problem.alternatives
        known = {"": self.known, **{law: self.known.laws[law] for law in laws}} if laws else {}
        return {law: of.log_evidence for law, of in known.items() if of.log_evidence is not None}

    @property
    def doubts(self) -> tuple[str, ...]:
        """Sentences about what speaks against the draws."""
        case = self.problem.experiments[0].case
        doubts = [doubt.text for doubt in doubts_of(self.known, case, self.specimen)]
        doubts += [
            f"law {legible(law)} is not compared: {reason}"
            for law, reason in self.not_compared.items()
        ]
        return tuple(doubts)

    def read(self) -> Problem:
        """Return the problem with the readings so far.

        Raises
        ------
        InputError : its faults; the file has other keys or another case than at the beginning.
        """
        problem, before = self.running.read(), self.problem
        name = legible(self.running.name)
        keys = ("fit.parameters", f"the case of {name}")
        changed = dict(zip(keys, _differences(problem, before), strict=True))
        # one that is missing is as changed as any
        laws = {law: problem.alternatives.get(law, problem) for law in before.alternatives}
        if not any(changed.values()):
            differences = (_differences(laws[law], of) for law, of in before.alternatives.items())
            changed["compare"] = any(map(any, differences))
        if any(changed.values()):
            parts = " and ".join(part for part, differs in changed.items() if differs)
            raise InputError(
                f"{self.running.source}: {parts} changed; must stay while {name} is followed"
            )
        alternatives = {
            law: replace(of, settings=before.alternatives[law].settings) for law, of in laws.items()
        }
        return replace(problem, settings=before.settings, alternatives=alternatives)


def _differences(problem: Problem, before: Problem) -> tuple[bool, bool]:
    """Tell whether the keys of two problems of one test differ, and whether its case does."""
    (test,), (former,) = problem.experiments, before.experiments
    return problem.parameters != before.parameters, test.case.text != former.case.text


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
    """Return a test with what a fit of tests knows before it, or raise InputError. On one rank."""
    problem, place = running.read(), f"{running.source}: {legible(running.name)}"
    if running.name in tests:
        raise InputError(
            f"{place}: is among the tests of {known.name}, so that its readings would count twice; "
            "must be followed after a fit without it"
        )
    (experiment,) = problem.experiments
    specimen = experiment.groups[0] or experiment.name
    specimen = specimen if specimen in known.values.specimens else NEXT
    missing = [legible(law) for law in known.laws if law not in problem.alternatives]
    unknown = [law for law in problem.alternatives if law not in known.laws] if known.laws else []
    if missing and unknown:
        raise InputError(
            f"{running.source}: compare.{legible(unknown[0])}: was not compared by {known.name}; "
            f"must be {' or '.join(missing)}, as there, or absent"
        )
    laws: dict[str, Problem] = {}
    not_compared = dict.fromkeys(unknown, f"{known.name} has no values of it")
    for law, law_knowledge in known.laws.items():
        if law not in problem.alternatives:
            not_compared[law] = f"{running.source} has no compare.{legible(law)}"
        elif known.log_evidence is None or law_knowledge.log_evidence is None:
            not_compared[law] = "the fit does not know the evidence of both laws"
        elif problem.settings.loss != "gaussian":
            not_compared[law] = f'loss = "{problem.settings.loss}" has no evidence'
        else:
            try:
                laws[law] = _followed(problem.alternatives[law], law_knowledge, place, specimen)
            except InputError as error:
                not_compared[law] = reason_of(error)
    problem = replace(_followed(problem, known, place, specimen), alternatives=laws)
    return FollowedTest(running, problem, known, specimen, not_compared)


def _followed(problem: Problem, known: FitKnowledge, place: str, specimen: str) -> Problem:
    """Return a problem with the random wear that a fit knows, or raise InputError."""
    (experiment,), values = problem.experiments, known.values
    if not len(values.scattering) and not values.sizes.any():
        raise InputError(f"{known.name}: {NOT_KNOWN}")
    if problem.keys != values.keys:
        raise InputError(
            f"{problem.name}: fits {', '.join(problem.keys)}; must be {', '.join(values.keys)}, "
            f"as {known.name}"
        )
    if is_elastic(experiment.case, problem.keys):
        raise InputError(
            f"{problem.name}: a modulus, a Poisson's ratio or a thickness is fitted; a test is "
            "followed with numbers of wear laws and friction only"
        )
    check_predicted(known, experiment.case, place, specimen)
    # the size itself is drawn
    process = {
        f"wear.{body}": ProcessNoise(size=1.0)
        for body, sizes in zip(("lower", "upper"), values.sizes.T, strict=True)
        if sizes.any()
    }
    return replace(problem, settings=replace(problem.settings, process=process))


def _tests_of(folder: Path) -> set[str]:
    """Return the names of the tests of a fit's folder."""
    if not (folder / FIT).is_file():  # told by who reads the fit
        return set()
    content = json.loads(read_text(folder / FIT))
    return set(content.get("experiments", {})) if isinstance(content, dict) else set()
