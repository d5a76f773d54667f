"""``rw.fit`` and ``ringwear fit``: the values of case keys that measurements tell."""

import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError, InputError, reason_of
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.estimation.intervals import estimates
from ringwear_par.identification.estimation.least_squares import LeastSquares
from ringwear_par.identification.estimation.minimise import Optimum, minimise
from ringwear_par.identification.estimation.plausible import refuse_idle, refuse_reversed
from ringwear_par.identification.estimation.posterior import missing_for, sample_posterior
from ringwear_par.identification.estimation.profile import likelihood_profiles
from ringwear_par.identification.estimation.starts import (
    Progress,
    Started,
    fill_planned,
    solve_from,
    solve_starts,
)
from ringwear_par.identification.model.lockstep import StoppedError
from ringwear_par.identification.model.rounds import Rounds
from ringwear_par.identification.model.steps import ENOUGH, STEPS
from ringwear_par.identification.outcome import FitResult
from ringwear_par.info import versions
from ringwear_par.options import reject_unused_options
from ringwear_par.parallel import on_first_rank, together, warn_of_threads
from ringwear_par.results.execution.stopping import StopSignals

log = logging.getLogger(__name__)

Source = Path | str | Mapping[str, Any]

#: relative change of a fitted noise at which it is found, and most rounds to get there
_SAME_NOISE, _MOST_ROUNDS = 1e-4, 20
#: how often steps are halved
_HALVINGS = 3


def fit(source: Source, comm: MPI.Intracomm | None = None, *, compare: bool = False) -> FitResult:
    """Return the values of case keys that measurements tell, with intervals.

    Collective on comm, the world's where none is given; the same on all ranks.

    Parameters
    ----------
    source : the name of a fit file, or the same as a dict.
    compare : whether the laws of ``[compare]`` are fitted as well.

    Raises
    ------
    InputError : all faults of the file and its data.
    ComputationError : no start leads to an optimum.
    """
    comm = MPI.COMM_WORLD if comm is None else comm
    problem = on_first_rank(comm, lambda: _readable(source))
    return fitted(problem, comm, compare=compare)


def fitted(
    problem: Problem, comm: MPI.Intracomm, *, compare: bool = False, folder: Path | None = None
) -> FitResult:
    """Do as ``fit`` with a problem that was read. Collective on comm.

    Other laws follow the first one, with linear intervals; one that fails does not end the fit.

    Parameters
    ----------
    folder : where optima of starts are kept until the fit is done; None: nowhere.
    """
    with StopSignals() as signals:
        found = _Posed(problem, "", Progress(folder, problem.key), signals, comm).solved()
        others: dict[str, FitResult] = {}
        failed: dict[str, str] = {}
        linear = replace(problem.settings, intervals=("linear",))
        for law, (name, other) in enumerate(problem.alternatives.items() if compare else (), 1):
            progress = Progress(folder, f"{other.key} {name}", law)
            try:
                posed = _Posed(replace(other, settings=linear), name, progress, signals, comm)
                others[name] = posed.solved()
            except StoppedError:
                raise
            except (ComputationError, InputError) as error:
                failed[name] = reason_of(error)
        return replace(found, alternatives=others, failed=failed)


def _readable(source: Source) -> Problem:
    """Return the problem of a fit file, if there is what its intervals need. On one rank."""
    problem = read_fit(source)
    if missing := missing_for(problem.settings.intervals):
        raise InputError(f"{problem.name}: {missing}")
    return problem


def predicted(problem: Problem, comm: MPI.Intracomm) -> FitResult:
    """Return what a fit would find if the parameters were those of the start. Collective."""
    with StopSignals() as signals:
        return _Posed(problem, "", Progress(None, ""), signals, comm).predicted()


class _Posed:
    """A problem with its histories. Making one is collective on comm."""

    def __init__(
        self,
        problem: Problem,
        name: str,
        progress: Progress,
        signals: StopSignals,
        comm: MPI.Intracomm,
    ) -> None:
        self._problem, self._name, self._progress, self._comm = problem, name, progress, comm
        hint = "; the same command with --restart goes on" if progress.kept else ""
        self._rounds = Rounds(problem, comm, signals, hint)
        self._squares = LeastSquares(problem, self._rounds)

    def solved(self) -> FitResult:
        """Return the best of all starts. Collective."""
        return self._told(self._solve)

    def predicted(self) -> FitResult:
        """Return what would be found at the start. Collective."""
        return self._told(self._predict)

    def _told(self, job: Callable[[], dict[str, Any]]) -> FitResult:
        """Return what a job of the first rank finds, on all of them. Collective."""
        squares = self._squares

        def told() -> tuple[Any, ...]:
            found = job()
            squares.keep(found["x"])
            return found, squares.data, squares.noise_scale, squares.steps, squares.known

        found, *kept = self._rounds.lead(told)
        squares.data, squares.noise_scale, squares.steps, squares.known = kept
        return FitResult(squares, **found, alternatives={}, versions=versions(), comm=self._comm)

    def _begin(self) -> FloatArray:
        """Return the unknowns at the start, where readings are what they are called."""
        fill_planned(self._squares)
        start = self._squares.started(list(self._problem.start.values()))
        refuse_idle(self._squares, start)
        refuse_reversed(self._squares, start)
        return start

    def _solve(self) -> dict[str, Any]:
        squares, histories = self._squares, self._rounds
        self._begin()
        starts = solve_starts(squares, histories, self._name, self._progress)
        x = np.array(self._best(starts).unknowns)
        of_profiles = 0
        while True:
            optimum = self._with_noise(x)
            told, covariance = estimates(squares, optimum.x, optimum.evaluation)
            moved = squares.moved(optimum.x, optimum.evaluation, covariance)
            may_halve = squares.steps < STEPS << _HALVINGS
            if moved is not None and may_halve and np.abs(moved).max() > ENOUGH:
                self._refine(moved)
                x = optimum.x
                continue
            before = histories.count
            histories.tell(f"{self._name}: intervals" if self._name else "intervals")
            profiles = likelihood_profiles(squares, optimum, told, covariance)
            of_profiles += histories.count - before
            if profiles.better is None:
                break
            log.info("a likelihood profile has found a better optimum; the fit goes on from there")
            starts.append(solve_from(squares, len(starts), profiles.better))
            if starts[-1].objective >= optimum.evaluation.objective:
                keys = tuple(p.key for p in self._problem.parameters)
                profiles = replace(profiles, unsure=keys)
                break
            x = np.array(starts[-1].unknowns)
        posterior = None
        if "posterior" in self._problem.settings.intervals:
            posterior = sample_posterior(
                squares, histories, optimum.x, covariance, self._progress.chain
            )
        return {
            "x": optimum.x,
            "evaluation": optimum.evaluation,
            "parameters": profiles.estimates,
            "covariance": covariance,
            "starts": tuple(starts),
            "histories": histories.count,
            "profiles": profiles.tables,
            "posterior": posterior,
            "histories_of_profiles": of_profiles,
            "unsure": profiles.unsure,
            "moved": {}
            if moved is None
            else dict(zip(self._problem.keys, moved.tolist(), strict=True)),
        }

    def _refine(self, moved: FloatArray) -> None:
        """Halve the steps, and say why."""
        most = int(np.abs(moved).argmax())
        self._squares.refine()
        log.info(
            "steps half as long move %s by %.2g sd; the fit goes on with %d instead of %d a test",
            self._problem.keys[most], moved[most], self._squares.steps, self._squares.steps // 2,
        )  # fmt: skip

    def _predict(self) -> dict[str, Any]:
        squares = self._squares
        x = self._begin()
        found = squares.evaluate(x)
        told, covariance = estimates(squares, x, found)
        return {
            "x": x,
            "evaluation": found,
            "parameters": told,
            "covariance": covariance,
            "starts": (),
            "histories": self._rounds.count,
            "profiles": {},
        }

    def _best(self, starts: list[Started]) -> Started:
        """Return the start with the smallest sum of squares; of equal ones the first."""
        ended = [one for one in starts if not one.error]
        if not ended:
            raise ComputationError(
                f"{self._problem.name}: none of {len(starts)} starts could be fitted: "
                f"{starts[0].error}"
            )
        smallest = min(one.objective for one in ended)
        return next(one for one in ended if one.objective <= smallest * (1.0 + 1e-9))

    def _with_noise(self, x: FloatArray) -> Optimum:
        """Return the optimum, with the noise that is to be fitted. Not collective."""
        squares = self._squares
        fitted_noise = np.array([series.sd_fitted for _, series in squares.series])
        for _ in range(_MOST_ROUNDS):
            optimum = minimise(squares, x)
            if not fitted_noise.any():
                return optimum
            growth = self._growth(optimum)
            x = optimum.x
            if np.abs(growth[fitted_noise] - 1.0).max() < _SAME_NOISE:
                return optimum
            squares.noise_scale = np.where(fitted_noise, growth, 1.0) * squares.noise_scale
        return optimum

    def _growth(self, optimum: Optimum) -> FloatArray:
        """Return by how much each series scatters more than its noise."""
        squares, found = self._squares, optimum.evaluation
        weighted = squares.weights(found.noise) * found.noise**2
        leverage = (np.linalg.qr(found.jacobian)[0] ** 2).sum(axis=1)
        return np.array(
            [
                np.sqrt(weighted[part].sum() / max(1.0, (1.0 - leverage[part]).sum()))
                for part in squares.parts
            ]
        )


def run_fit(
    source: Path,
    folder: Path,
    comm: MPI.Intracomm,
    *,
    dry_run: bool = False,
    restart: bool = False,
    compare: bool = False,
) -> None:
    """Fit and write the outcome to a folder, or in a dry run print what to expect. Collective."""
    from ringwear_par.identification import storing
    from ringwear_par.identification.summary import prediction

    if dry_run:
        found = predicted(on_first_rank(comm, lambda: read_fit(source, plans=True)), comm)
        if comm.rank == 0:
            print(prediction(found))
        return
    problem = on_first_rank(comm, lambda: _readable(source))
    on_first_rank(comm, lambda: storing.check(folder))
    if restart and on_first_rank(comm, lambda: storing.complete(folder, problem, compare=compare)):
        if comm.rank == 0:
            log.info("%s: the fit is complete; nothing is left to be done", folder)
        return
    if comm.rank == 0:
        warn_of_threads(comm.size)
    if not restart:
        on_first_rank(comm, lambda: storing.refuse_interrupted(folder))
    found = fitted(problem, comm, compare=compare, folder=folder)
    with together(comm):
        reject_unused_options()

    found.save(folder)
    on_first_rank(comm, Progress(folder, "").forget)
    if comm.rank == 0:
        print(found.summary())
        if problem.alternatives and not compare:
            log.info(
                "[compare] was not looked at: --compare fits %s", ", ".join(problem.alternatives)
            )
