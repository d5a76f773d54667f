"""Several starts, each to its optimum; outcomes are stored for a restart."""

import json
import logging
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import InputError, RingwearError, reason_of
from ringwear_par.files.folders import PROGRESS
from ringwear_par.files.text import read_text
from ringwear_par.files.writing import atomic_write
from ringwear_par.identification.estimation.minimise import minimise
from ringwear_par.identification.estimation.misfit import Misfit
from ringwear_par.identification.estimation.posterior import MarginalLikelihood
from ringwear_par.identification.model.histories import ROUGH_STEPS, Histories
from ringwear_par.identification.model.rounds import Rounds, StoppedError, WaitFor, side_by_side

log = logging.getLogger(__name__)

#: share of the largest derivative at any point: below it a parameter has no effect
_STILL = 1e-6
_SEED = 0
#: number of points of which a start is the best
_LOT = 8
#: how often points are drawn, twice as many each time, where too few of them are cases
_DOUBLINGS = 6
#: starts that advance side by side
_MOST_TOGETHER = 64


@dataclass(frozen=True)
class StartOutcome:
    """The outcome of one start."""

    #: of the start.
    number: int
    #: values of the fitted keys.
    start: tuple[float, ...]
    optimum: tuple[float, ...]
    #: at the optimum, nuisances included.
    unknowns: tuple[float, ...]
    #: half the sum of squares there.
    objective: float
    converged: bool
    iterations: int
    #: computed for it.
    histories: int
    #: why there is no optimum, "" if there is.
    error: str = ""


class StoredStarts:
    """The folder with the outcomes of starts until the fit is done; None stores nothing.

    Outcomes of another problem, of another key, are not used; ``law`` numbers those that are
    compared.
    """

    def __init__(self, folder: Path | None, key: str, law: int = 0) -> None:
        self._folder, self._key, self._law = folder, key, law

    @property
    def hint(self) -> str:
        """What the message of a fit that is stopped says of its outcomes."""
        if self._folder is None:
            return ""
        progress = self._folder / PROGRESS
        stored = progress.is_dir() and any(progress.iterdir())
        return "; the same command with --restart goes on" if stored else "; nothing written"

    def refuse_others(self) -> None:
        """Refuse a folder whose outcomes are of another fit (InputError). Not collective."""
        if self._folder is None:
            return
        numbers = [int(path.stem[2:]) for path in (self._folder / PROGRESS).glob("0-*.json")]
        if numbers and not any(map(self.read, numbers)):
            raise InputError(
                f"{self._folder}: holds an interrupted fit of another file, data or version; "
                "--restart needs the same, --overwrite starts anew"
            )

    @property
    def chain(self) -> Path | None:
        """The file of the posterior's chain, if outcomes are stored."""
        return None if self._folder is None else self._folder / PROGRESS / "posterior.npz"

    def _path(self, number: int) -> Path | None:
        if self._folder is None:
            return None
        return self._folder / PROGRESS / f"{self._law}-{number}.json"

    def read(self, number: int) -> StartOutcome | None:
        """Return the stored outcome of a start, if there is one. Not collective."""
        path = self._path(number)
        try:
            content = json.loads(read_text(path)) if path is not None else None
            if not isinstance(content, dict) or content.pop("key") != self._key:
                return None
            lists = {k: tuple(v) for k, v in content.items() if isinstance(v, list)}
            return StartOutcome(**{**content, **lists})
        except (InputError, ValueError, TypeError, KeyError):
            return None

    def write(self, outcome: StartOutcome) -> None:
        """Store the outcome of a start; a full disk only costs the restart. Not collective."""
        path = self._path(outcome.number)
        if path is None:
            return
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(path) as temporary:
                temporary.write_text(json.dumps({"key": self._key, **asdict(outcome)}))
        except OSError as error:
            log.warning("%s: cannot be written: %s", path, error.strerror or error)

    def remove(self) -> None:
        """Remove all stored outcomes, and the folder where nothing else is in it. On one rank."""
        if self._folder is None or not (self._folder / PROGRESS).is_dir():
            return
        for path in (self._folder / PROGRESS).iterdir():
            path.unlink(missing_ok=True)
        (self._folder / PROGRESS).rmdir()
        with suppress(OSError):
            self._folder.rmdir()


def case_points(misfit: Misfit, count: int) -> FloatArray:
    """Return Sobol' points (count, m) within the bounds of the keys' unknowns. Not collective.

    Those that are no case, for a law has rules for its numbers together, are left out; InputError
    where hardly any point is one.
    """
    from scipy.stats import qmc  # slow to import

    problem, m = misfit.problem, len(misfit.problem.parameters)
    low, high = misfit.lower[:m], misfit.upper[:m]
    sampler = qmc.Sobol(m, scramble=True, seed=_SEED)
    more = 1 << max(count - 1, 0).bit_length()
    good: list[FloatArray] = []
    for _ in range(_DOUBLINGS):
        drawn = low + (high - low) * sampler.random(more)
        good += list(drawn[misfit.responses.allowed(drawn)])
        if len(good) >= count:
            return np.array(good[:count])
        more = sampler.num_generated
    keys = ", ".join(f"{p.key} = [{p.bounds[0]:g}, {p.bounds[1]:g}]" for p in problem.parameters)
    raise InputError(
        f"{problem.name}: bounds of {keys}: {len(good)} of {sampler.num_generated} points within "
        "them are cases; must leave room for what the wear laws allow of their numbers together"
    )


def start_points(misfit: Misfit, histories: Histories) -> FloatArray:
    """Return unknowns (starts, m): the parameters' own starts, then the best points of some lots.

    Each lot is spread over all bounds, so that starts stay apart. Where a threshold is above all
    pressures, nothing wears and no derivative says where to go: a lot of such points is replaced by
    the best one left of the others. Not collective.
    """
    problem = misfit.problem
    first = problem.unknowns(list(problem.start.values()))[None]
    lots, m = problem.settings.starts - 1, first.shape[1]
    if not lots:
        return first
    drawn = case_points(misfit, _LOT * lots)
    values = np.array([misfit.values(x) for x in drawn])
    marginal = MarginalLikelihood(misfit, np.append(first[0], misfit.expected_nuisances))
    moves, improbable = np.zeros((len(drawn), m)), np.full(len(drawn), np.inf)
    for i, response in enumerate(
        histories.responses(values, ROUGH_STEPS, exact=misfit.responses.exact)
    ):
        if not isinstance(response, Exception):
            slopes = misfit.whitened(response[:, 1:] * problem.slopes(values[i]))
            moves[i] = np.linalg.norm(slopes, axis=0)
            improbable[i] = -marginal(values[i], response[:, 0])
    still = (moves <= _STILL * moves.max(axis=0)).sum(axis=1)  # parameters that move nothing there
    marks = list(zip(still.tolist(), improbable.tolist(), strict=True))
    order = sorted(range(len(drawn)), key=marks.__getitem__)
    best = [next(i for i in order if i // _LOT == lot) for lot in range(lots)]
    left = [i for i in order if i not in best]
    chosen = []
    for i in best:
        better = bool(left) and marks[left[0]][0] < marks[i][0]
        chosen.append(left.pop(0) if better else i)
    return np.concatenate([first, drawn[chosen]])


def solve_starts(
    misfit: Misfit, histories: Rounds, name: str, progress: StoredStarts
) -> list[StartOutcome]:
    """Return the outcomes of all starts, which advance side by side. Not collective."""
    numbers = range(misfit.problem.settings.starts)
    stored = [progress.read(number) for number in numbers]
    outcomes = [outcome for outcome in stored if outcome is not None]
    left = [number for number in numbers if stored[number] is None]
    # of the search as a whole, whenever it was stopped
    histories.count += sum(outcome.histories for outcome in outcomes)
    histories.tell(_state(name, len(numbers), outcomes))
    if left:
        unknowns = start_points(misfit, histories)
    else:
        histories.count += _LOT * (len(numbers) - 1) * len(misfit.problem.experiments)

    def solved(number: int, wait_for: WaitFor) -> None:
        outcomes.append(_solved(misfit, number, unknowns[number], wait_for))
        progress.write(outcomes[-1])

    def compute(points: list[FloatArray]) -> None:
        misfit.responses.compute(points)
        histories.tell(_state(name, len(numbers), outcomes))

    for first in range(0, len(left), _MOST_TOGETHER):
        part = left[first : first + _MOST_TOGETHER]
        side_by_side([partial(solved, number) for number in part], compute)
    return sorted(outcomes, key=lambda outcome: outcome.number)


def solve_from(misfit: Misfit, number: int, x: FloatArray) -> StartOutcome:
    """Return the outcome of one more start, from unknowns (u,). Not collective."""
    start = x[: len(misfit.problem.parameters)]
    (outcome,) = side_by_side([partial(_solved, misfit, number, start)], misfit.responses.compute)
    return outcome


def _state(name: str, total: int, outcomes: list[StartOutcome]) -> str:
    """Return how many starts have ended, and how well."""
    best = min((2.0 * outcome.objective for outcome in outcomes if not outcome.error), default=None)
    law = f"{name}: " if name else ""
    smallest = "" if best is None else f", smallest chi2 (with priors) {best:.6g}"
    return f"{law}{len(outcomes)} of {total} starts have ended{smallest}"


def _solved(misfit: Misfit, number: int, unknowns: FloatArray, wait_for: WaitFor) -> StartOutcome:
    values = tuple(misfit.values(unknowns).tolist())
    first = np.concatenate([unknowns, np.zeros(len(misfit.names) - len(unknowns))])
    histories = 0

    def count_and_wait(x: FloatArray) -> None:
        nonlocal histories
        histories += len(misfit.problem.experiments)
        wait_for(x)

    try:
        if not misfit.responses.are_computed(first):
            count_and_wait(first)
        optimum = minimise(misfit, misfit.with_best_nuisances(values), count_and_wait)
        misfit.responses.forget([first], optimum.x)
    except StoppedError:
        raise
    except RingwearError as error:
        failed = reason_of(error)
        return StartOutcome(number, values, (), (), float("inf"), False, 0, histories, failed)
    return StartOutcome(
        number,
        values,
        tuple(misfit.values(optimum.x).tolist()),
        tuple(optimum.x.tolist()),
        optimum.evaluation.objective,
        optimum.converged,
        optimum.iterations,
        histories,
    )


def fill_planned(misfit: Misfit) -> None:
    """Let planned readings be the model's at the start, nuisances as expected. Not collective."""
    plans = [(part, series) for _, series, part in misfit.records if series.planned]
    if not plans:
        return
    start = misfit.problem.unknowns(list(misfit.problem.start.values()))
    x = np.concatenate([start, misfit.expected_nuisances])
    expected = misfit.model_readings(x) + misfit.nuisance_readings(x)
    for part, _ in plans:
        misfit.data[part] = expected[part]
