"""Several starts: where from, each to its optimum, and what was found kept for a restart."""

import json
import logging
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError, InputError, RingwearError, reason_of
from ringwear_par.files.text import parse_json, read_text
from ringwear_par.files.writing import atomic_write
from ringwear_par.identification.estimation.least_squares import LeastSquares
from ringwear_par.identification.estimation.marginal import Marginal
from ringwear_par.identification.estimation.minimise import minimise
from ringwear_par.identification.model.histories import Histories
from ringwear_par.identification.model.lockstep import Meet, StoppedError, side_by_side
from ringwear_par.identification.model.rounds import Rounds

log = logging.getLogger(__name__)

#: of the largest derivative of any point: below it a parameter moves nothing
_STILL = 1e-6
#: folder in that of the outcome, until this is whole
PROGRESS = "progress"
_SEED = 0
#: points of which a start is the best, and steps of the histories that tell
_LOT, _COARSE = 8, 10
#: how often points are drawn, each time as many as before, where too few of them are cases
_DOUBLINGS = 6
#: starts that advance side by side
_MOST_TOGETHER = 64


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
    def chain(self) -> Path | None:
        """The file of a posterior's chain, if anything is kept."""
        return None if self._folder is None else self._folder / PROGRESS / "posterior.npz"

    def _path(self, number: int) -> Path | None:
        if self._folder is None:
            return None
        return self._folder / PROGRESS / f"{self._law}-{number}.json"

    def read(self, number: int) -> Started | None:
        """Return what is kept of a start; None if nothing is. Not collective."""
        path = self._path(number)
        try:
            kept = parse_json(read_text(path)) if path is not None else None
            if not isinstance(kept, dict) or kept.pop("key") != self._key:
                return None
            lists = {k: tuple(v) for k, v in kept.items() if isinstance(v, list)}
            return Started(**{**kept, **lists})
        except (InputError, ValueError, TypeError, KeyError):
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
        if self._folder is None or not (self._folder / PROGRESS).is_dir():
            return
        for path in (self._folder / PROGRESS).iterdir():
            path.unlink(missing_ok=True)
        (self._folder / PROGRESS).rmdir()


def points(squares: LeastSquares, count: int) -> FloatArray:
    """Return Sobol' points (count, m) within the bounds of the fitted keys' unknowns.

    Those that are no case, for a law has rules for its numbers together, are left out. Not
    collective.

    Raises
    ------
    InputError : hardly any point is one.
    """
    from scipy.stats import qmc  # slow to import

    problem, m = squares.problem, len(squares.problem.parameters)
    low, high = squares.lower[:m], squares.upper[:m]
    sampler = qmc.Sobol(m, scramble=True, seed=_SEED)
    more = 1 << max(count - 1, 0).bit_length()
    good: list[FloatArray] = []
    for _ in range(_DOUBLINGS):
        drawn = low + (high - low) * sampler.random(more)
        good += list(drawn[squares.allowed(drawn)])
        if len(good) >= count:
            return np.array(good[:count])
        more = sampler.num_generated
    keys = ", ".join(f"{p.key} = [{p.bounds[0]:g}, {p.bounds[1]:g}]" for p in problem.parameters)
    raise InputError(
        f"{problem.name}: bounds of {keys}: {len(good)} of {sampler.num_generated} points within "
        "them are cases; must leave room for what the wear laws allow of their numbers together"
    )


def screened(squares: LeastSquares, histories: Histories) -> FloatArray:
    """Return unknowns (starts, m): the parameters' own starts, then the best points of some lots.

    Each lot is spread over all bounds, so that starts stay apart. Where a threshold is above all
    pressures, nothing wears and no derivative says where to go: a lot of such points is replaced by
    the best one left of the others. Not collective.
    """
    problem = squares.problem
    first = np.array([[p.unknown(p.start) for p in problem.parameters]])
    lots, m = problem.settings.starts - 1, first.shape[1]
    if not lots:
        return first
    drawn = points(squares, _LOT * lots)
    values = np.array([squares.values(x) for x in drawn])
    marginal = Marginal(squares)
    moves, improbable = np.zeros((len(drawn), m)), np.full(len(drawn), np.inf)
    for i, found in enumerate(histories.responses(values, _COARSE)):
        if not isinstance(found, ComputationError):
            slopes = squares.whitened(found[:, 1:] * squares.slopes(values[i]))
            moves[i] = np.linalg.norm(slopes, axis=0)
            improbable[i] = -marginal(values[i], found[:, 0])
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
    squares: LeastSquares, histories: Rounds, name: str, progress: Progress
) -> list[Started]:
    """Return what comes of all starts, which advance side by side. Not collective.

    Parameters
    ----------
    name : of the law, as progress is told; "" of the first.
    """
    numbers = range(squares.problem.settings.starts)
    kept = [progress.read(number) for number in numbers]
    found = [one for one in kept if one is not None]
    left = [number for number in numbers if kept[number] is None]
    # of the search as a whole, whenever it was stopped
    histories.count += sum(one.histories for one in found)
    histories.tell(_state(name, len(numbers), found))
    if left:
        unknowns = screened(squares, histories)
    else:
        histories.count += _LOT * (len(numbers) - 1) * len(squares.problem.experiments)

    def solved(number: int, meet: Meet) -> None:
        found.append(_solved(squares, number, unknowns[number], meet))
        progress.write(found[-1])

    def compute(points: list[FloatArray]) -> None:
        squares.look_up(points)
        histories.tell(_state(name, len(numbers), found))

    for first in range(0, len(left), _MOST_TOGETHER):
        part = left[first : first + _MOST_TOGETHER]
        side_by_side([partial(solved, number) for number in part], compute)
    return sorted(found, key=lambda one: one.number)


def solve_from(squares: LeastSquares, number: int, x: FloatArray) -> Started:
    """Return what comes of one more start, from unknowns (u,). Not collective."""
    start = x[: len(squares.problem.parameters)]
    (found,) = side_by_side([partial(_solved, squares, number, start)], squares.look_up)
    return found


def _state(name: str, total: int, found: list[Started]) -> str:
    """Return how many starts have ended, and how well."""
    best = min((2.0 * one.objective for one in found if not one.error), default=None)
    law = f"{name}: " if name else ""
    smallest = "" if best is None else f", smallest chi2 (with priors) {best:.6g}"
    return f"{law}{len(found)} of {total} starts have ended{smallest}"


def _solved(squares: LeastSquares, number: int, unknowns: FloatArray, meet: Meet) -> Started:
    values = tuple(squares.values(unknowns).tolist())
    first = np.concatenate([unknowns, np.zeros(len(squares.names) - len(unknowns))])
    asked = 0

    def counted(x: FloatArray) -> None:
        nonlocal asked
        asked += len(squares.problem.experiments)
        meet(x)

    try:
        if not squares.knows(first):
            counted(first)
        optimum = minimise(squares, squares.started(values), counted)
        squares.forget([first], optimum.x)
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


def fill_planned(squares: LeastSquares) -> None:
    """Let planned readings be what the model has at the start, nuisances as their priors have them.

    Not collective.

    Raises
    ------
    ComputationError : a history.
    """
    plans = [
        (part, series)
        for (_, series), part in zip(squares.series, squares.parts, strict=True)
        if series.planned
    ]
    if not plans:
        return
    m = len(squares.problem.parameters)
    start = [p.unknown(p.start) for p in squares.problem.parameters]
    x = np.concatenate([start, np.zeros(len(squares.names) - m)])
    for j, prior in squares.priors:
        if j >= m:
            x[j] = prior.mean
    expected = squares.bare(x) + squares.nuisance_columns @ x[m:]
    for part, _ in plans:
        squares.data[part] = expected[part]
