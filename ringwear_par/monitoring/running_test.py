"""A test that runs: one experiment of a fit file, whose files grow while it is followed."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from ringwear_par.cases.files.columns import FileStore
from ringwear_par.cases.files.keys import base_keys
from ringwear_par.errors import InputError, legible
from ringwear_par.files.measurements import Measurements, measurements_in
from ringwear_par.files.table_text import decode
from ringwear_par.files.text import parse_toml, read_text
from ringwear_par.identification.definition.averaging import averaged
from ringwear_par.identification.definition.fit_file import experiment_tables, read_fit
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.definition.scatter import check_scatter

_MARKS = b"\xff\xfe", b"\xfe\xff"


class GrowingFiles(FileStore):
    """Files of measurements, of which some are written to: their last line may not be whole."""

    def __init__(self, folder: Path, growing: frozenset[str]) -> None:
        super().__init__(folder)
        self.growing = growing

    def __call__(self, name: str, skip: int = 0, drop: Sequence[str] = ()) -> Measurements:
        """Return a file's table, without a last line that has no end."""
        if name not in self.growing:
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
    #: names of its files, all of which grow
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
        base = base_keys(str(source), source.parent, tables, False, [])
        named = {
            table["name"]: table
            for _, table in experiment_tables(str(source), tables, base, store, [])
            if isinstance(table, Mapping) and isinstance(table.get("name"), str)
        }
        if not named:  # the fit file's own sentences say why
            read_fit(source)
        name = [*named][-1] if name is None else name
        if name not in named:
            known = ", ".join(map(legible, named))
            raise InputError(f"--test = {legible(name)}: must be one of {known} of {source}")
        entries = [named[name].get(kind) for kind in ("data", "input")]
        files = frozenset(
            entry["file"]
            for every in entries
            for entry in (every if isinstance(every, list) else [])
            if isinstance(entry, Mapping) and isinstance(entry.get("file"), str)
        )
        return cls(source, name, files, len(named) == 1)

    @property
    def _growing(self) -> GrowingFiles:
        return GrowingFiles(self.source.parent, self.files)

    @property
    def file_stamps(self) -> list[tuple[int, int, int]]:
        """What changes when the fit file or one of the test's files is written to."""
        stamps = []
        for name in (self.source.name, *sorted(self.files)):
            with suppress(OSError):  # it may be replaced just now
                status = (self.source.parent / name).stat()
                stamps.append((status.st_ino, status.st_size, status.st_mtime_ns))
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
        whole = read_fit(self.source, files=self._growing)
        tests = tuple(test for test in whole.experiments if test.name != self.name)
        faults: list[str] = []
        check_scatter(replace(whole, name=place, experiments=tests), faults)
        if faults:
            raise InputError(*faults)
        return replace(whole, experiments=tests, alternatives={})

    def read(self) -> Problem:
        """Return the problem of this test alone, with its readings so far.

        Raises
        ------
        InputError : its faults, and what cannot be followed.
        """
        problem = read_fit(self.source, test=self.name, files=self._growing)
        (test,) = problem.experiments
        faults = [
            f"{self.source}: {legible(self.name)}: {series.file or series.name}: {assumption}; its "
            "unit must be given"
            for series in test.series
            for assumption in series.assumptions
        ]
        if faults:
            raise InputError(*faults)
        series = tuple(averaged(record, test.case.time.end) for record in test.series)
        return replace(problem, experiments=(replace(test, series=series),), alternatives={})
