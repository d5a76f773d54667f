"""``rw.design`` and ``ringwear design``: the next tests that tell most of the fitted keys.

The information of tests adds, nuisances of each being eliminated, so that the histories of all
candidates, one each, tell what every combination of them would. It is averaged over what the keys
may be: draws from an earlier fit or from priors.
"""

import itertools
import json
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from scipy.stats import norm, qmc

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.text import shortened
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.identification.candidates import Candidate, candidates
from ringwear_par.identification.fit_file import read_fit
from ringwear_par.identification.histories import Histories
from ringwear_par.identification.problem import Criterion, Experiment, Problem
from ringwear_par.identification.readings import nuisance_columns, whitened
from ringwear_par.info import versions
from ringwear_par.parallel import on_first_rank
from ringwear_par.textfiles import read_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Source = Path | str | Mapping[str, Any]

#: draws of the keys, and their seed
_DRAWS, _SEED = 8, 0
#: information, over the widths of bounds, that is no more than round-off
_NOTHING = 1e-9
#: pairs of candidates that are looked at together
_AT_ONCE = 20_000
#: designs that are told, and rounds of exchange in their search
_TOLD, _ROUNDS = 10, 20


@dataclass(frozen=True, eq=False)
class Design:
    """Tests to make together, and what they would tell.

    Parameters
    ----------
    tests : their candidates, by number.
    score : by the criterion, larger is better.
    sd : (m,) predicted standard deviations of the keys' values, as far as they are what they seem.
    range : (2, m) smallest and largest over the draws.
    correlation : (m, m).
    """

    tests: tuple[int, ...]
    score: float
    sd: FloatArray
    range: FloatArray
    correlation: FloatArray


@dataclass(frozen=True, eq=False)
class DesignResult:
    """What ``design`` found, with a fixed set of names in ``to_dict``.

    Parameters
    ----------
    problem : the fit.
    criterion : what was compared.
    candidates : all tests.
    single : (c, m) predicted standard deviations after each candidate alone.
    designs : the best ones, the best first.
    planned : what the experiments of the fit file tell by themselves.
    nominal : (m,) values of the keys, as they seem to be.
    draws : how many values of the keys were looked at.
    after : the earlier fit whose information counts, "" for none.
    pairs : of two tests: (c, c, m) predicted standard deviations; (0, 0, m) otherwise.
    histories : computed.
    versions : of the software.
    comm : of the ranks that have looked.
    """

    problem: Problem
    criterion: Criterion
    candidates: tuple[Candidate, ...]
    single: FloatArray
    designs: tuple[Design, ...]
    planned: Design
    nominal: FloatArray
    draws: int
    after: str
    pairs: FloatArray
    histories: int
    versions: Mapping[str, str]
    comm: Any

    def __repr__(self) -> str:
        tests = " + ".join(str(self.candidates[i].told()) for i in self.designs[0].tests)
        return f"<DesignResult: {tests}>"

    def to_dict(self) -> dict[str, Any]:
        """Return what design.json holds."""
        keys = self.problem.keys
        return {
            "criterion": self.criterion,
            "parameters": dict(zip(keys, self.nominal.tolist(), strict=True)),
            "after": self.after or None,
            "draws": self.draws,
            "candidates": len(self.candidates),
            "histories": self.histories,
            "measured_as": self.problem.experiments[0].name,
            "designs": [self._told(each) for each in self.designs],
            "fit_file": self._predicted(self.planned),
            "versions": dict(self.versions),
        }

    def _told(self, one: Design) -> dict[str, Any]:
        tests = [self.candidates[i] for i in one.tests]
        return {
            "experiments": [test.told() for test in tests],
            "seconds": sum(test.seconds for test in tests),
            **self._predicted(one),
        }

    def _predicted(self, one: Design) -> dict[str, Any]:
        keys = self.problem.keys
        pairs = itertools.combinations(range(len(keys)), 2)
        return {
            "score": _finite(one.score),
            "sd": {key: _finite(v) for key, v in zip(keys, one.sd.tolist(), strict=True)},
            "sd_range": {
                key: [_finite(v) for v in ends]
                for key, ends in zip(keys, one.range.T.tolist(), strict=True)
            },
            "correlation": {
                f"{keys[i]}, {keys[j]}": _finite(float(one.correlation[i, j])) for i, j in pairs
            },
        }

    def summary(self) -> str:
        """Return the outcome in a few lines."""
        from ringwear_par.identification.design_summary import summary

        return summary(self)

    def plot(self) -> "Figure":
        """Return the map of predicted standard deviations."""
        from ringwear_par.identification.design_figures import figure

        return figure(self)

    def save(self, folder: str | Path) -> None:
        """Write design.json, next.toml and design.png to a folder, which is made.

        Where several ranks have looked, all of them call this, and the first writes.

        Raises
        ------
        InputError : a folder that cannot be written.
        ComputationError : the disk.
        """
        from ringwear_par.identification.design_summary import save

        on_first_rank(self.comm, lambda: save(self, Path(folder)))


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


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

    Raises
    ------
    InputError : all faults of the file and its data, or of the earlier fit.
    ComputationError : a history of a candidate.
    """
    comm = MPI.COMM_WORLD if comm is None else comm

    def read() -> tuple[Problem, "_Belief", tuple[Candidate, ...]]:
        problem = read_fit(source)
        if criterion is not None:
            problem = replace(problem, design=replace(problem.design, criterion=criterion))
        told = _belief(problem, after)
        if problem.design.criterion == "eig" and not _is_whole(told.information):
            raise InputError(
                f'{problem.name}: design: criterion = "eig": needs something that is known before, '
                "a prior of every parameter or an earlier fit (--after)"
            )
        if not problem.design.ranges:
            raise InputError(
                f"{problem.name}: design.vary: is missing or empty; must name what may "
                "differ between tests, as the range of load.pressure"
            )
        found = tuple(candidates(problem.design, problem.experiments[0]))
        _check_budget(problem, found)
        return problem, told, found

    problem, told, tests = on_first_rank(comm, read)
    space = problem.design
    count = space.experiments
    information, histories = _informations(
        problem, [test.experiment for test in tests], told.draws, comm
    )
    planned, more = _informations(problem, problem.experiments, told.draws, comm)
    search = _Search(problem, told, information, tests)
    best = search.best(count)
    single, pairs = search.singles(), search.pairs() if count == 2 else np.zeros((0, 0, 0))
    return DesignResult(
        problem, space.criterion, tests, single, tuple(best), search.planned(planned),
        told.nominal, len(told.draws), told.after, pairs, histories + more, versions(), comm,
    )  # fmt: skip


def run_design(
    source: Path,
    folder: Path,
    comm: MPI.Intracomm,
    *,
    after: Path | None = None,
    criterion: Criterion | None = None,
) -> None:
    """Find the next tests and write them to a folder. Collective on comm."""
    from ringwear_par.identification.design_summary import FILES
    from ringwear_par.identification.storing import check

    on_first_rank(comm, lambda: check(folder, FILES))
    found = design(source, comm, after=after, criterion=criterion)
    found.save(folder)
    if comm.rank == 0:
        print(found.summary())


def _is_whole(information: FloatArray) -> bool:
    return bool(np.linalg.matrix_rank(information, hermitian=True) == len(information))


def _check_budget(problem: Problem, tests: tuple[Candidate, ...]) -> None:
    """Refuse a budget that is too small for any design."""
    count, seconds = problem.design.experiments, problem.design.seconds
    end = problem.experiments[0].case.time.end
    shortest = min((test.seconds for test in tests), default=end)
    if seconds is not None and shortest * count > seconds * (1.0 + 1e-9):
        raise InputError(
            f"{problem.name}: design.budget: time.end = {seconds:g}: must be at least "
            f"{shortest * count:g}, {count} of the shortest tests"
        )


# -- what is known before --------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Belief:
    """What is known of the keys before.

    Parameters
    ----------
    nominal : (m,) values.
    information : (m, m) of the unknowns.
    draws : (d, m) values, the nominal ones first.
    after : the earlier fit, "" for none.
    """

    nominal: FloatArray
    information: FloatArray
    draws: FloatArray
    after: str


def _belief(problem: Problem, after: str | Path | None) -> _Belief:
    """Return what priors or an earlier fit tell. Raises InputError."""
    parameters = problem.parameters
    if after is None:
        nominal = np.array([p.start for p in parameters])
        by = [0.0 if p.prior is None else p.slope(p.start) / p.prior.sd for p in parameters]
        information = np.diag(np.square(by))
    else:
        nominal, information = _earlier(problem, Path(after))
    known = np.diag(information) > 0.0
    if not known.any():
        return _Belief(nominal, information, nominal[None], str(after or ""))
    part = np.linalg.cholesky(np.linalg.inv(information[np.ix_(known, known)]))
    normal = norm.ppf(qmc.Sobol(int(known.sum()), scramble=True, seed=_SEED).random(_DRAWS))
    unknowns = np.array([p.unknown(v) for p, v in zip(parameters, nominal, strict=True)])
    drawn = np.tile(unknowns, (_DRAWS, 1))
    drawn[1:, known] += (normal @ part.T)[1:]
    values = [[p.value(float(u)) for p, u in zip(parameters, row, strict=True)] for row in drawn]
    return _Belief(nominal, information, np.array(values), str(after or ""))


def _earlier(problem: Problem, folder: Path) -> tuple[FloatArray, FloatArray]:
    """Return estimates and their information (of the unknowns) from an earlier fit."""
    path, keys = folder / "fit.json", list(problem.keys)
    text = read_text(path)
    try:
        told = json.loads(text)
        there, own = told["keys"], told["parameters"]
        nominal = np.array([own[key]["estimate"] for key in there], dtype=float)
        table = [[np.nan if v is None else v for v in row] for row in told["covariance"]]
        covariance = np.array(table, dtype=float).reshape(len(there), len(there))
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: is no outcome of ringwear fit") from error
    if sorted(there) != sorted(keys):
        raise InputError(
            f"{path}: keys = {shortened(there)}: must be those of {problem.name}, {', '.join(keys)}"
        )
    order = [there.index(key) for key in keys]
    nominal, covariance = nominal[order], covariance[np.ix_(order, order)]
    pairs = zip(problem.parameters, nominal.tolist(), strict=True)
    slopes = np.array([parameter.slope(value) for parameter, value in pairs])
    known = np.isfinite(np.diag(covariance))
    information = np.zeros_like(covariance)
    part = (covariance / np.outer(slopes, slopes))[np.ix_(known, known)]
    try:
        information[np.ix_(known, known)] = np.linalg.inv(part)
    except np.linalg.LinAlgError as error:
        raise InputError(f"{path}: covariance: is singular") from error
    return nominal, information


# -- what tests would tell -------------------------------------------------------------------------


def _informations(
    problem: Problem, tests: list[Experiment] | tuple[Experiment, ...], draws: FloatArray,
    comm: MPI.Intracomm,
) -> tuple[FloatArray, int]:  # fmt: skip
    """Return what each test tells of the unknowns, (draws, tests, m, m), and histories computed.

    Collective on comm, whose ranks share the tests.
    """
    numbers = list(range(len(tests)))[comm.rank :: comm.size] or [0]
    own = tuple(tests[number] for number in numbers)
    histories = Histories(replace(problem, experiments=own, alternatives={}), comm)
    m = len(problem.parameters)
    found = np.empty((len(draws), len(own), m, m))
    ends = np.cumsum([test.n for test in own])
    for d, values in enumerate(draws):
        (response,) = histories.responses(values[None])
        if isinstance(response, Exception):
            raise ComputationError(f"{problem.name}: design: {response}")
        slopes = [p.slope(v) for p, v in zip(problem.parameters, values.tolist(), strict=True)]
        for e, (test, rows) in enumerate(zip(own, np.split(response, ends[:-1]), strict=True)):
            found[d, e] = _information(test, rows[:, 1:] * slopes)
    every: dict[int, FloatArray] = {}
    for part, values in comm.allgather((numbers, found)):
        every |= {number: values[:, place] for place, number in enumerate(part)}
    whole = np.stack([every[number] for number in range(len(tests))], axis=1)
    return whole, comm.allreduce(histories.count)


def _information(test: Experiment, columns: FloatArray) -> FloatArray:
    """Return what a test tells of the unknowns (m, m), all that is known of nuisances eliminated.

    Parameters
    ----------
    columns : (n, m) derivatives of its readings.
    """
    m, begin, rows, priors = columns.shape[1], 0, [], []
    counts = [len(series.nuisances) for series in test.series]
    for i, series in enumerate(test.series):
        part = slice(begin, begin + series.n)
        begin = part.stop
        own = np.zeros((series.n, m + sum(counts)))
        own[:, :m] = columns[part]
        first = m + sum(counts[:i])
        own[:, first : first + counts[i]] = nuisance_columns(series, test.case)
        rows.append(whitened(series, own / series.sd[:, None]))
        priors += [0.0 if n.prior is None else 1.0 / n.prior.sd for n in series.nuisances]
    stacked = np.concatenate([*rows, np.diag([*[0.0] * m, *priors])])
    size = np.linalg.norm(stacked, axis=0)
    stacked[:, m:] /= np.where(size > 0.0, size, 1.0)[m:]
    nuisances = stacked[:, m:]
    basis, values, _ = np.linalg.svd(nuisances, full_matrices=False)
    basis = basis[:, values > 1e-10]
    left: FloatArray = stacked[:, :m] - basis @ (basis.T @ stacked[:, :m])
    return left.T @ left


# -- the best of them ------------------------------------------------------------------------------


class _Search:
    """Looks for the best tests.

    Parameters
    ----------
    told : what is known before.
    information : (d, c, m, m) of each candidate, at each draw.
    tests : the candidates.
    """

    def __init__(
        self,
        problem: Problem,
        told: _Belief,
        information: FloatArray,
        tests: Sequence[Candidate],
    ) -> None:
        self._parameters, self._space = problem.parameters, problem.design
        self._nominal = told.nominal
        self._seconds = np.array([test.seconds for test in tests])
        self._loads = [test.loads for test in tests]
        widths = np.array(
            [p.unknown(p.bounds[1]) - p.unknown(p.bounds[0]) for p in self._parameters]
        )
        self._widths, scale = widths, np.outer(widths, widths)
        # over the widths of bounds, and never singular
        self._before = told.information * scale
        self._floor = _NOTHING * np.eye(len(widths))
        self._information = information * scale

    def best(self, count: int) -> list[Design]:
        """Return the best designs of so many tests."""
        c = len(self._seconds)
        nothing = np.zeros_like(self._information[:, 0])
        limit = np.inf if self._space.seconds is None else self._space.seconds * (1.0 + 1e-9)
        if count == 1:
            numbers = np.flatnonzero(self._seconds <= limit)
            return self._told(numbers[:, None])
        pairs = np.array(list(itertools.combinations_with_replacement(range(c), 2)))
        spent = self._seconds[pairs].sum(axis=1)
        shortest = float(self._seconds.min())
        left = limit - shortest * (count - 2)
        if count == 2:
            return self._told(pairs[spent <= limit])
        # from the best pair with the shortest others on, two are exchanged at a time
        start = self._best_of(pairs[spent <= left], nothing)
        tests = np.append(start, [int(self._seconds.argmin())] * (count - 2))
        score = self._score(self._information[:, tests].sum(axis=1)[:, None])[0]
        for _ in range(_ROUNDS):
            before = score
            for i, j in itertools.combinations(range(count), 2):
                others = np.delete(tests, [i, j])
                rest = self._information[:, others].sum(axis=1)
                room = limit - self._seconds[others].sum()
                pair = self._best_of(pairs[spent <= room], rest)
                changed = np.append(others, pair)
                new = self._score(self._information[:, changed].sum(axis=1)[:, None])[0]
                if new > score:
                    tests, score = changed, new
            if score <= before:
                break
        return self._told(np.sort(tests)[None])

    def _best_of(self, pairs: IntArray, rest: FloatArray) -> IntArray:
        scores = self._scores(pairs, rest)
        best: IntArray = pairs[int(scores.argmax())]
        return best

    def _scores(self, tests: IntArray, rest: FloatArray | None = None) -> FloatArray:
        """Return the score of each row of tests, (rows, count)."""
        found = []
        for first in range(0, len(tests), _AT_ONCE):
            part = tests[first : first + _AT_ONCE]
            whole = np.sum([self._information[:, column] for column in part.T], axis=0)
            found.append(self._score(whole if rest is None else whole + rest[:, None]))
        return np.concatenate(found)

    def _score(self, information: FloatArray) -> FloatArray:
        """Return the mean over draws of the criterion of information (d, rows, m, m)."""
        after = information + self._before + self._floor
        if self._space.criterion == "A":
            scores = -np.trace(np.linalg.inv(after), axis1=-2, axis2=-1)
        else:
            scores = 0.5 * np.linalg.slogdet(after)[1]
            if self._space.criterion == "eig":
                scores = scores - 0.5 * np.linalg.slogdet(self._before)[1]
        mean: FloatArray = scores.mean(axis=0)
        return mean

    def _told(self, tests: IntArray) -> list[Design]:
        scores = self._scores(tests)
        found: dict[Hashable, Design] = {}
        for i in np.argsort(-scores, kind="stable").tolist():
            # of the same loads and other durations the best one is told
            kind = tuple(sorted(self._loads[test] for test in tests[i]))
            if kind not in found:
                found[kind] = self._design(tests[i], float(scores[i]))
            if len(found) == _TOLD:
                break
        return list(found.values())

    def _design(self, tests: IntArray, score: float) -> Design:
        return self._predicted(
            tuple(tests.tolist()), self._information[:, tests].sum(axis=1), score
        )

    def planned(self, information: FloatArray) -> Design:
        """Return what tests of information (d, tests, m, m) tell together."""
        whole = information.sum(axis=1) * np.outer(self._widths, self._widths)
        return self._predicted((), whole, float(self._score(whole[:, None])[0]))

    def _predicted(self, tests: tuple[int, ...], whole: FloatArray, score: float) -> Design:
        covariance = np.linalg.inv(whole + self._before + self._floor)
        spread = self._natural(covariance)
        nominal = covariance[0]
        root = np.sqrt(np.diag(nominal))
        return Design(
            tests, score, spread[0], np.stack([spread.min(axis=0), spread.max(axis=0)]),
            nominal / np.outer(root, root),
        )  # fmt: skip

    def _natural(self, covariance: FloatArray) -> FloatArray:
        """Return standard deviations (..., m) of values; infinite beyond the bounds' widths."""
        share = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
        slopes = [p.slope(v) for p, v in zip(self._parameters, self._nominal.tolist(), strict=True)]
        spread: FloatArray = np.where(share < 1.0, share * self._widths * slopes, np.inf)
        return spread

    def singles(self) -> FloatArray:
        """Return predicted standard deviations after each candidate alone, (c, m)."""
        return self._natural(np.linalg.inv(self._information[0] + self._before + self._floor))

    def pairs(self) -> FloatArray:
        """Return those after two candidates, (c, c, m); NaN beyond the budget."""
        information = self._information[0]
        rows = [
            self._natural(np.linalg.inv(information + one + self._before + self._floor))
            for one in information
        ]
        found = np.array(rows)
        if self._space.seconds is not None:
            spent = self._seconds[:, None] + self._seconds
            found[spent > self._space.seconds * (1.0 + 1e-9)] = np.nan
        return found
