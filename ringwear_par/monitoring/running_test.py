"""A test that runs: one experiment of a fit file, whose files grow while it is followed."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ringwear_par.cases.files.columns import FileStore
from ringwear_par.errors import InputError, legible
from ringwear_par.files.measurements import Measurements, measurements_in
from ringwear_par.files.table_text import decode
from ringwear_par.files.text import parse_toml, read_text
from ringwear_par.identification.definition.averaging import averaged
from ringwear_par.identification.definition.fit_file import experiment_tables, read_fit
from ringwear_par.identification.definition.problem import Problem, Series
from ringwear_par.identification.definition.reading_kinds import READING_KINDS
from ringwear_par.identification.definition.scatter import check_scatter

#: why nothing can be followed
NOT_KNOWN = (
    "has neither scatter nor random wear, and a sensor's intervals would stop tests too early: "
    'scatter = "fit" with repeats, a known scatter, or process is needed'
)
_MARKS = b"\xff\xfe", b"\xfe\xff"


class GrowingFiles(FileStore):
    """Files of measurements, of which some are written to: their last line may not be whole."""

    def __init__(self, folder: Path, growing: frozenset[str]) -> None:
        super().__init__(folder)
        self._growing = growing

    def __call__(self, name: str, skip: int = 0, drop: Sequence[str] = ()) -> Measurements:
        """Return a file's table, without a last line that has no end."""
        if name not in self._growing:
            return super().__call__(name, skip, drop)
        return self.read(name, _whole_lines, skip=skip).without(drop)


def _whole_lines(path: Path, skip: int) -> Measurements:
    try:
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read: {reason}") from error
    if not content.startswith(_MARKS):
        whole = content[: content.rfind(b"\n") + 1]
        if not whole:
            decode(str(path), content)  # refused if it is no text
        content = whole
    return measurements_in(content, str(path), skip=skip)


@dataclass(frozen=True)
class RunningTest:
    """Which experiment of a fit file runs."""

    #: the fit file
    source: Path
    #: of the experiment
    name: str
    #: names of its files
    files: frozenset[str]
    #: whether the fit file has no other
    alone: bool

    @classmethod
    def of(cls, source: Path, name: str | None) -> "RunningTest":
        """Return an experiment of a fit file by its name; None: the last one.

        Raises
        ------
        InputError : there is none of this name.
        """
        tables, store = parse_toml(read_text(source), str(source)), FileStore(source.parent)
        named: dict[str, Any] = {}
        for _, table in experiment_tables(str(source), tables, None, store, []):
            if isinstance(table, Mapping) and isinstance(table.get("name"), str):
                named[table["name"]] = table.get("data")
        if not named:  # the fit file's own sentences tell
            read_fit(source)
        name = [*named][-1] if name is None else name
        if name not in named:
            known = ", ".join(legible(known) for known in named)
            raise InputError(f"--test = {legible(name)}: must be one of {known} of {source}")
        series = named[name] if isinstance(named[name], list) else []
        files = {s["file"] for s in series if isinstance(s, Mapping) and "file" in s}
        texts = frozenset(file for file in files if isinstance(file, str))
        return cls(source, name, texts, len(named) == 1)

    @property
    def missing(self) -> list[Path]:
        """Its files that have no readings yet."""
        paths = [self.source.parent / name for name in sorted(self.files)]
        return [path for path in paths if not _has_readings(path)]

    @property
    def file_stamps(self) -> list[tuple[int, int, int] | None]:
        """What changes when the fit file or one of the test's files is written to."""
        paths = [self.source, *(self.source.parent / name for name in sorted(self.files))]
        stamps: list[tuple[int, int, int] | None] = [None] * len(paths)
        for number, path in enumerate(paths):
            with suppress(OSError):  # it may be replaced just now
                status = path.stat()
                stamps[number] = status.st_ino, status.st_size, status.st_mtime_ns
        return stamps

    def other_tests(self) -> Problem:
        """Return the problem of the other tests of the fit file, to be fitted before.

        Raises
        ------
        InputError : faults of the file; there is none, or they cannot tell what scatters.
        """
        place = f"{self.source}: without {legible(self.name)}"
        if self.alone:
            raise InputError(
                f"{place} has no test; --after must name the folder of a fit of others"
            )
        whole = read_fit(self.source, files=GrowingFiles(self.source.parent, self.files))
        if not whole.mixed:
            raise InputError(f"{self.source}: {NOT_KNOWN}")
        tests = tuple(test for test in whole.experiments if test.name != self.name)
        faults: list[str] = []
        check_scatter(replace(whole, name=place, experiments=tests), faults)
        if faults:
            raise InputError(*faults)
        return replace(whole, experiments=tests, alternatives={})

    def read(self) -> Problem:
        """Return the problem of this test alone, with its readings so far, under all laws.

        Raises
        ------
        InputError : its faults, and what cannot be followed.
        """
        files = GrowingFiles(self.source.parent, self.files)
        problem = read_fit(self.source, test=self.name, files=files)
        (experiment,) = problem.experiments
        faults = [fault for series in experiment.series for fault in _faults(series)]
        faults += [
            f"{measured.key}: is a measured input, which must cover the test; must be a number or "
            "a table of the case while a test runs"
            for measured in experiment.inputs
        ]
        if faults:
            raise InputError(*(f"{self.source}: {legible(self.name)}: {f}" for f in faults))
        series = tuple(averaged(record, experiment.case.time.end) for record in experiment.series)
        laws = {law: _with_series(other, series) for law, other in problem.alternatives.items()}
        return replace(_with_series(problem, series), alternatives=laws)


def _with_series(problem: Problem, series: tuple[Series, ...]) -> Problem:
    """Return a problem of one test with other readings."""
    (experiment,) = problem.experiments
    return replace(problem, experiments=(replace(experiment, series=series),))


def _has_readings(path: Path) -> bool:
    """Tell whether a file has a line of names and a whole line below it."""
    try:
        return path.read_bytes().count(b"\n") > 1
    except (OSError, ValueError):
        return False


def _faults(series: Series) -> list[str]:
    """Return why a series cannot be followed."""
    name = series.name
    allowed = [kind for kind, of in READING_KINDS.items() if of.values is not None]
    rules = {
        f"{name}: must be one of {', '.join(allowed)} while a test runs; the fit after it reads "
        "profiles and layers": series.kind not in allowed,
        f'{name}: sd = "fit": must be a number while a test runs, such as the sd of experiments in '
        "fit.json of earlier tests": series.sd_fitted,
        f"{name}: censored readings have no normal density, by which draws are weighed; must be "
        "left out while a test runs": series.censored is not None and series.censored.any(),
    }
    faults = [f"{series.file or name}: {a}; its unit must be given" for a in series.assumptions]
    return faults + [rule for rule, broken in rules.items() if broken]
