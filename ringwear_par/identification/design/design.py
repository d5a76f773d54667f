"""``rw.design`` and ``ringwear design``: the next tests that tell most of the fitted keys.

The information of tests adds, nuisances of each being projected out, so that m + 1 histories a
candidate, at a few draws of what is known, tell what every combination of them would.
"""

import itertools
import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.errors import ComputationError, InputError, counted
from ringwear_par.files.folders import BARS, DESIGN, check_folder, json_bytes, write_outcome
from ringwear_par.files.writing import announce_replacement, closing_line
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.fitted_parameters import unit_of_key, unit_scale
from ringwear_par.identification.definition.problem import Criterion, FittedParameter, Problem
from ringwear_par.identification.design.candidates import (
    INSTANTS,
    LOADS,
    Candidate,
    axes,
    candidates,
)
from ringwear_par.identification.design.information import Before, before_tests, informations
from ringwear_par.identification.histories import Readings
from ringwear_par.parallel import on_first_rank
from ringwear_par.pictures.key_panels import design_panels
from ringwear_par.pictures.matplotlib import panel_figure
from ringwear_par.pictures.style import picture
from ringwear_par.results.result import Outcome
from ringwear_par.results.signals import StopSignals
from ringwear_par.version import versions

Source = Path | str | Mapping[str, Any]
_MOST_CANDIDATES = 2000
#: designs that are listed, and shown by a summary; combinations scored together
_LISTED, _SHOWN, _AT_ONCE = 10, 5, 50_000
#: share of the sd that bounds alone leave, below which a key of which nothing else was known is
#: identified; factor on an sd that is nearly the same
_IDENTIFIED, _NEARLY = 0.5, 1.1
#: inches: width and height of a panel, height of a test of a design in bars
_WIDTH, _HEIGHT, _LINE = 4.6, 4.2, 0.2
_CRITERIA = {"D": "smallest volume of the confidence ellipsoid (D)",
             "A": "smallest mean variance over the widths of the bounds (A)"}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Design:
    """Tests to make together, and what they would tell."""

    #: their candidates, by number
    tests: tuple[int, ...]
    #: bits, information on all keys: one bit halves one sd
    gain: float
    #: (m,) predicted standard deviations of the keys' values; infinite: not identified
    sd: FloatArray


@dataclass(frozen=True, eq=False)
class DesignResult(Outcome):
    """The result of ``design``: all tests that could be made, and what any of them would tell."""

    #: the fit
    problem: Problem
    #: what is known before
    before: Before
    #: (c,) tests that have histories
    candidates: tuple[Candidate, ...]
    #: (c, d, m, m) information in each about the unknowns of the material, at each draw
    information: FloatArray
    #: folder of the earlier fit that counts, "" for none
    after: str
    #: number of tests that have no history, and why the first one has none
    failed: int
    reason: str
    #: number of histories
    histories: int

    @property
    def today(self) -> Design:
        """What is known without further tests."""
        return self._design(np.zeros_like(self.information[0]))

    @property
    def single(self) -> FloatArray:
        """(c, m) predicted standard deviations after each candidate alone."""
        return self._sd_of_values(self.information)

    def _sd_of_values(self, information: FloatArray) -> FloatArray:
        """Return standard deviations (..., m) of values by information (..., d, m, m)."""
        sd, before = self._sd(information), self.before
        most = _IDENTIFIED * np.sqrt(np.diag(before.covariance))
        return np.where(before.unknown & (sd > most), np.inf, sd * before.slopes)

    def _sd(self, information: FloatArray) -> FloatArray:
        """Return standard deviations (..., m) of unknowns, of their mean variance over draws."""
        covariance = np.linalg.inv(np.linalg.inv(self.before.covariance) + information)
        sd: FloatArray = np.sqrt(np.diagonal(covariance.mean(axis=-3), axis1=-2, axis2=-1))
        return sd

    def _gain(self, information: FloatArray) -> FloatArray:
        """Return the logarithms (...) of how much smaller the ellipsoid becomes, means of draws."""
        precision = np.linalg.inv(self.before.covariance)
        gain = np.linalg.slogdet(precision + information)[1] - np.linalg.slogdet(precision)[1]
        return 0.5 * gain.mean(axis=-1)

    def _score(self, information: FloatArray) -> FloatArray:
        """Return the gain by "D", minus the mean variance over the widths of bounds by "A"."""
        if self.problem.design.criterion == "D":
            return self._gain(information)
        low, high = self.problem.unknown_bounds
        return -np.square(self._sd(information) / (high - low)).mean(axis=-1)

    def _design(self, information: FloatArray, tests: Sequence[int] = ()) -> Design:
        """Return the design of tests that have information (d, m, m) together."""
        gain = float(self._gain(information)) / np.log(2.0)
        return Design((*tests,), gain, self._sd_of_values(information))

    def _scores(self, tests: IntArray) -> FloatArray:
        """Return the score (rows,) of tests (rows, count) together; -inf beyond the time."""
        seconds = np.array([test.seconds for test in self.candidates])
        scores = np.full(len(tests), -np.inf)
        within = np.flatnonzero(seconds[tests].sum(axis=1) <= self.problem.design.time_limit)
        for rows in np.array_split(within, len(within) // _AT_ONCE + 1):
            scores[rows] = self._score(sum(self.information[column] for column in tests[rows].T))
        return scores

    @cached_property
    def designs(self) -> tuple[Design, ...]:
        """The best designs that differ in more than durations and instants, the best first.

        All of one or two tests are looked at. Of more, the best pair that leaves time for the
        shortest tests beside it; then each is exchanged for the best one, twice.
        """
        count, every = self.problem.design.experiments, np.arange(len(self.candidates))
        tests = every[:, None] if count == 1 else np.column_stack(np.triu_indices(len(every)))
        if count > 2:
            shortest = min(every, key=lambda i: self.candidates[i].seconds)
            filled = np.column_stack([tests, np.full((len(tests), count - 2), shortest)])
            best, looked = filled[self._scores(filled).argmax()], []
            for place in 2 * [*range(2, count), 0, 1]:
                looked.append(np.tile(best, (len(every), 1)))
                looked[-1][:, place] = every
                best = looked[-1][self._scores(looked[-1]).argmax()]
            tests = np.concatenate(looked)
        scores, kinds = self._scores(tests), dict[Hashable, IntArray]()
        for row in np.argsort(-scores, kind="stable").tolist():
            if len(kinds) == _LISTED or scores[row] == -np.inf:
                break
            kind = tuple(sorted(self.candidates[i].kind for i in tests[row]))
            kinds.setdefault(kind, tests[row])
        return tuple(
            self._design(self.information[some].sum(axis=0), some.tolist())
            for some in kinds.values()
        )

    def _only_number(self) -> dict[str, list[float]]:
        """Return keys whose scatter alone limits what tests tell, whichever they are.

        Of each the sd of values between specimens, and the least that so many more can leave.
        """
        best, before, limited = self.designs[0], self.before, {}
        count, precision = len(best.tests), np.diag(np.linalg.inv(before.covariance))
        usual = np.median(self._sd_of_values(count * self.information), axis=0)
        for j, key in enumerate(self.problem.keys):
            if not (variance := before.scatter[j]):
                continue
            least = float(before.slopes[j] / np.sqrt(precision[j] + count / variance))
            if best.sd[j] < _NEARLY * least and usual[j] < _NEARLY * best.sd[j]:
                limited[key] = [float(before.slopes[j] * np.sqrt(variance)), least]
        return limited

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of design.json."""
        problem, space = self.problem, self.problem.design
        scales = {
            p.key: {"factor": 100.0 / value, "unit": "%"} if p.log
            else {"factor": 1.0 / unit_scale(p), "unit": _unit(problem, p)}
            for p, value in zip(problem.parameters, self.before.values.tolist(), strict=True)
        }  # fmt: skip

        def entry(design: Design) -> dict[str, Any]:
            sd = [value if np.isfinite(value) else None for value in design.sd.tolist()]
            return {"gain": design.gain, "sd": dict(zip(problem.keys, sd, strict=True))}

        designs = []
        for design in self.designs:
            tests = [self.candidates[i] for i in design.tests]
            designs.append(
                {"name": " + ".join(test.name(space) for test in tests),
                 "experiments": [test.to_dict() for test in tests],
                 "seconds": sum(test.seconds for test in tests), **entry(design)}
            )  # fmt: skip
        return {
            "criterion": space.criterion,
            "parameters": dict(zip(problem.keys, self.before.values.tolist(), strict=True)),
            "after": self.after or None, "candidates": len(self.candidates),
            "failed": self.failed, "reason": self.reason or None,
            "histories": self.histories, "measured_as": problem.experiments[0].name,
            "sd_scales": scales, "designs": designs, "today": entry(self.today),
            "only_number_matters": self._only_number(), "versions": versions(),
        }  # fmt: skip

    def summary(self) -> str:
        """Return the outcome in a few lines."""
        problem, content = self.problem, self.to_dict()
        about = ", ".join(
            f"{p.key} = {value / unit_scale(p):.4g} {_unit(problem, p)}".rstrip()
            for p, value in zip(problem.parameters, content["parameters"].values(), strict=True)
        )
        around = (
            "without priors or an earlier fit (--after) it holds there only"
            if self.before.unknown.all() else f"means over {len(self.before.draws)} draws"
        )  # fmt: skip
        count = len(self.designs[0].tests)
        lines = [
            f"{problem.name}: {count} of {content['candidates']} tests, "
            f"{_CRITERIA[content['criterion']]}; measured as in {content['measured_as']}; "
            f"{self.histories} histories",
            f"{f'after {self.after}' if self.after else 'at the start'}: {about}; {around}",
        ]
        if scattering := [p.key for p in problem.parameters if p.scatter is not None]:
            lines.append(
                f"each test is of a new specimen, and {', '.join(scattering)} differs between "
                "specimens, by as much as is taken as known; numbers below are of the material"
            )
        rows = [("today", content["today"])]
        rows += [(design["name"], design) for design in content["designs"][:_SHOWN]]
        width = max(len(name) for name, _ in rows)
        for name, design in rows:
            sds = "; ".join(
                f"{key} not identified" if sd is None else f"{key} sd {_in_unit(content, key, sd)}"
                for key, sd in design["sd"].items()
            )
            gain = f"; gain {design['gain']:.3g} bits" * (name != "today")
            lines.append(f"  {name.ljust(width)}  {sds}{gain}")
        for key, ends in content["only_number_matters"].items():
            between, least = (_in_unit(content, key, sd) for sd in ends)
            lines.append(
                f"{key}: specimens differ by {between}, so that {count} more leave an sd of "
                f"{least} at least, and most candidates come near it: only their number matters"
            )
        if self.failed:
            tests = counted(self.failed, "test")
            lines.append(f"{tests} without a history are left out: {self.reason}")
        return "\n".join(lines)

    def plot(self) -> Figure:
        """Return bars of the predicted standard deviations of the best designs."""
        content = self.to_dict()
        panels = design_panels(content)
        lines = sum(len(entry["experiments"]) for entry in content["designs"])
        return panel_figure([panels], (_WIDTH * len(panels), max(_HEIGHT, _LINE * lines)))

    def save(self, path: str | Path) -> None:
        """Write both files into a folder, see ``write_outcome``."""
        contents = {
            BARS: lambda: picture(self.plot, str(Path(path, BARS))),
            DESIGN: lambda: json_bytes(self.to_dict()),
        }
        write_outcome(Path(path), "fit", contents)


def _unit(problem: Problem, parameter: FittedParameter) -> str:
    return parameter.unit or unit_of_key(problem, parameter.key).strip()


def _in_unit(content: Mapping[str, Any], key: str, sd: float) -> str:
    """Return a standard deviation of a key as people read it."""
    scale = content["sd_scales"][key]
    return f"{scale['factor'] * sd:.2g} {scale['unit']}".rstrip()


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
    ComputationError : too few candidates have a history.

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
        before = before_tests(problem, None if after is None else Path(after))
        return problem, before, candidates(problem.design, problem.experiments[0])

    problem, before, tests = on_first_rank(comm, read)
    # whose depths shares of random wear are of
    existing = problem.experiments if problem.settings.process else ()
    whole = (*existing, *dict.fromkeys(test.experiment for test in tests))
    parts = [(whole.index(test.experiment), test.series) for test in tests]
    # signals are not waited for: there is nothing to keep
    readings = Readings(replace(problem, experiments=whole, alternatives={}), comm, StopSignals())

    def lead() -> DesignResult:
        information = informations(readings, before, len(existing), parts)
        good, space = np.isfinite(information).all(axis=(1, 2, 3)), problem.design
        left = tuple(itertools.compress(tests, good))
        shortest = min((test.seconds for test in left), default=np.inf)
        failed = len(tests) - len(left)
        if shortest * space.experiments > space.time_limit or not left:
            raise ComputationError(
                f"{problem.name}: design: {failed} of {len(tests)} tests cannot be computed, which "
                f"leaves too few: {readings.reason}"
            )
        result = DesignResult(
            problem, before, left, information[good], str(after or ""), failed, readings.reason,
            readings.count,
        )  # fmt: skip
        assert result.designs  # once, on this rank
        return result

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
    if (count := math.prod(map(len, axes(space)))) > _MOST_CANDIDATES:
        raise InputError(
            f"{name}.vary: makes {count} tests; must be at most {_MOST_CANDIDATES}: fewer keys, or "
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
    files = (DESIGN, BARS)
    on_first_rank(comm, lambda: check_folder(folder, files, "fit"))
    result = design(source, comm, after=after, criterion=criterion)

    def save() -> None:
        announce_replacement(folder / DESIGN)
        result.save(folder)

    on_first_rank(comm, save)
    if comm.rank == 0:
        print(result.summary())
        print(closing_line(folder, files))
