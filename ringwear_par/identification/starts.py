"""Several starts: where from, each to its optimum, and what was found kept for a restart."""

import json
import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.atomic import atomic_write
from ringwear_par.errors import ComputationError, RingwearError, reason_of
from ringwear_par.identification.chain import Keeper
from ringwear_par.identification.least_squares import Evaluation, LeastSquares
from ringwear_par.identification.lockstep import Meet, StoppedError, side_by_side
from ringwear_par.identification.minimise import minimise
from ringwear_par.identification.problem import Problem

log = logging.getLogger(__name__)

_SEED = 0
#: how often a start is drawn nearer to the first one
_MOST_DRAWS = 12
#: starts that advance side by side
_MOST_TOGETHER = 64
#: wall seconds between lines of progress
_PROGRESS_SECONDS = 10.0


@dataclass(frozen=True)
class Started:
    """What came of one start.

    Parameters
    ----------
    number : of the start.
    start, optimum : values of the fitted keys.
    unknowns : at the optimum, nuisances included.
    objective : half the sum of squares there.
    histories : computed for it.
    error : why there is no optimum, "" if there is.
    """

    number: int
    start: tuple[float, ...]
    optimum: tuple[float, ...]
    unknowns: tuple[float, ...]
    objective: float
    converged: bool
    iterations: int
    histories: int
    error: str = ""


class Progress:
    """Where optima of starts are kept until the fit is done.

    Parameters
    ----------
    folder : of the results; None: nothing is kept.
    key : of the problem; what another problem has left is not used.
    law : number of the law among those that are compared, 0 the first.
    """

    def __init__(self, folder: Path | None, key: str, law: int = 0) -> None:
        self._folder, self._key, self._law = folder, key, law

    @property
    def kept(self) -> bool:
        """Whether anything is kept."""
        return self._folder is not None

    @property
    def walk(self) -> Keeper:
        """Where the walk of a posterior is kept."""
        path = None if self._folder is None else self._folder / "progress" / "posterior.npz"
        return Keeper(path, self._key)

    def _path(self, number: int) -> Path | None:
        if self._folder is None:
            return None
        return self._folder / "progress" / f"{self._law}-{number}.json"

    def read(self, number: int) -> Started | None:
        """Return what is kept of a start; None if nothing is. Not collective."""
        path = self._path(number)
        try:
            kept = json.loads(path.read_text()) if path is not None else None
            if not isinstance(kept, dict) or kept.pop("key") != self._key:
                return None
            lists = {k: tuple(v) for k, v in kept.items() if isinstance(v, list)}
            return Started(**{**kept, **lists})
        except (OSError, ValueError, TypeError, KeyError):
            return None

    def write(self, found: Started) -> None:
        """Keep what came of a start; a full disk only costs the restart. Not collective."""
        path = self._path(found.number)
        if path is None:
            return
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(path) as temporary:
                temporary.write_text(json.dumps({"key": self._key, **asdict(found)}))
        except OSError as error:
            log.warning("%s: cannot be written: %s", path, error.strerror or error)

    def forget(self) -> None:
        """Remove what was kept. On one rank.

        Raises
        ------
        OSError : the folder.
        """
        if self._folder is None or not (self._folder / "progress").is_dir():
            return
        for path in (self._folder / "progress").iterdir():
            path.unlink(missing_ok=True)
        (self._folder / "progress").rmdir()


def points(problem: Problem) -> FloatArray:
    """Return unknowns (starts, m): those of the parameters' own starts, then Sobol' points."""
    parameters = problem.parameters
    first = np.array([p.unknown(p.start) for p in parameters])
    count = problem.settings.starts
    if count == 1:
        return first[None]
    from scipy.stats import qmc  # slow to import

    low, high = np.array([[p.unknown(b) for b in p.bounds] for p in parameters]).T
    sampler = qmc.Sobol(len(parameters), scramble=True, seed=_SEED)
    drawn = sampler.random_base2(max(count - 2, 0).bit_length())[: count - 1]
    return np.concatenate([first[None], low + (high - low) * drawn])


def responsive(squares: LeastSquares, unknowns: FloatArray) -> FloatArray:
    """Return starts from which every parameter can be felt. Not collective.

    Where a threshold is above all pressures, nothing wears and no derivative says where to go: such
    a start is drawn half way to the first one, which all must reach by itself, again and again.

    Parameters
    ----------
    unknowns : (s, m), the first one first.
    """
    m = unknowns.shape[1]
    nothing = np.zeros(len(squares.names) - m)
    widths = (squares.upper - squares.lower)[:m]

    def felt(rows: FloatArray) -> list[BoolArray]:
        """Return which parameters move some reading by its noise, over their bounds."""
        whole = [np.concatenate([row, nothing]) for row in rows]
        squares.look_up(whole)
        found = []
        for x in whole:
            try:
                columns = squares.evaluate(x).noise_jacobian[:, :m]
            except ComputationError:
                columns = np.zeros((1, m))
            found.append(np.linalg.norm(columns, axis=0) * widths > 1.0)
        return found

    moved = unknowns.copy()
    waiting = np.arange(len(moved))
    for _ in range(_MOST_DRAWS):
        told = felt(np.concatenate([moved[:1], moved[waiting]]))
        reference, others = told[0], told[1:]
        waiting = waiting[[bool((reference & ~own).any()) for own in others]]
        if not len(waiting):
            break
        moved[waiting] = 0.5 * (moved[waiting] + moved[0])
    return moved


def solve_starts(
    squares: LeastSquares,
    unknowns: FloatArray,
    numbers: Sequence[int],
    name: str,
    progress: Progress,
    stop: Callable[[], bool],
) -> list[Started]:
    """Return the optima of some starts, by number, until ``stop`` says so. Not collective.

    They advance side by side.

    Parameters
    ----------
    unknowns : (s, m) of all starts.
    name : of the law, as progress is told; "" of the first.
    """
    kept = {number: progress.read(number) for number in numbers}
    found = [one for one in kept.values() if one is not None]
    left = [number for number in numbers if kept[number] is None]
    telling = _Telling(name, len(numbers), found)
    for first in range(0, len(left), _MOST_TOGETHER):
        part = left[first : first + _MOST_TOGETHER]
        ready = responsive(squares, unknowns[[0, *part]])[1:]

        def solved(number: int, start: FloatArray, meet: Meet) -> None:
            found.append(_solved(squares, number, start, meet))
            progress.write(found[-1])

        def compute(points: list[FloatArray]) -> None:
            squares.look_up(points)
            telling(squares.histories)

        jobs = [partial(solved, number, start) for number, start in zip(part, ready, strict=True)]
        for outcome in side_by_side(jobs, compute, stop):
            if isinstance(outcome, StoppedError):
                return found
            if isinstance(outcome, BaseException):
                raise outcome
    return found


class _Telling:
    """A line of progress now and then."""

    def __init__(self, name: str, total: int, found: list[Started]) -> None:
        self._name, self._total, self._found = name, total, found
        self._told = time.perf_counter()

    def __call__(self, histories: int) -> None:
        if time.perf_counter() - self._told < _PROGRESS_SECONDS:
            return
        self._told = time.perf_counter()
        best = min((2.0 * one.objective for one in self._found), default=float("inf"))
        log.info(
            "%s%d of %d starts have ended, %d histories, smallest sum of squares %.6g",
            f"{self._name}: " if self._name else "", len(self._found), self._total, histories, best,
        )  # fmt: skip


def _solved(squares: LeastSquares, number: int, unknowns: FloatArray, meet: Meet) -> Started:
    bounds = squares.lower, squares.upper
    values = tuple(squares.values(unknowns).tolist())
    asked = 0

    def evaluate(x: FloatArray) -> Evaluation:
        nonlocal asked
        if not squares.knows(x):
            asked += len(squares.problem.experiments)
            meet(x)
        return squares.evaluate(x)

    try:
        start = squares.started(values)
        method = squares.problem.settings.method
        optimum = minimise(evaluate, start, bounds, method, squares.idle, squares.linear)
    except StoppedError:
        raise
    except RingwearError as error:
        failed = reason_of(error)
        return Started(number, values, (), (), float("inf"), False, 0, asked, failed)
    return Started(
        number,
        values,
        tuple(squares.values(optimum.x).tolist()),
        tuple(optimum.x.tolist()),
        optimum.evaluation.objective,
        optimum.converged,
        optimum.iterations,
        asked,
    )
