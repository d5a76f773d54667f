"""The folder of a sweep: which cases it holds, and where.

``results.h5`` and ``cases.csv`` are written when a sweep ends; until then its cases are in
``shards``, those that a stop interrupted in ``inflight``, shared operators in ``operators``. Slices
of a study keep to files of their own until the whole is merged.
"""

import shutil
import sqlite3
from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path

from ringwear_par.atomic import check_writable, unwritable
from ringwear_par.cases.keys import read_keys
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.history.balances import Balances
from ringwear_par.results.checkpoints import restored
from ringwear_par.results.files import open_result
from ringwear_par.results.reading import UnreadableError
from ringwear_par.results.variables import PROFILES
from ringwear_par.studies import dataset, shards
from ringwear_par.studies.dataset import RESULTS, Row
from ringwear_par.studies.shards import Entry, Record
from ringwear_par.studies.study import case_id


@contextmanager
def telling_unreadable() -> Iterator[None]:
    """Have a sweep fail where a file of its folder cannot be read now: that is no bad input."""
    try:
        yield
    except UnreadableError as error:
        raise ComputationError(str(error)) from error


_FOLDERS = ("shards", "inflight", "operators")


@dataclass(frozen=True)
class Store:
    """Names in a sweep's folder.

    Parameters
    ----------
    folder : of the sweep.
    part : "" for the whole, or the slice, such as "2-8".
    """

    folder: Path
    part: str = ""

    def shard(self, team: int) -> Path:
        """Return the file that a team writes to."""
        return self.folder / "shards" / f"{self.part or 'all'}_{team:04d}.sqlite"

    def inflight(self, identity: str) -> Path:
        """Return the file of a case that was interrupted."""
        return self.folder / "inflight" / f"{identity}.h5"

    def operator(self, group: int) -> Path:
        """Return the file of a group's operator."""
        return self.folder / "operators" / f"{self.part or 'all'}_{group}.npy"

    @property
    def stopped(self) -> Path:
        """The file that is there after a stop: run the same command again."""
        return self.folder / f"STOPPED{'.' if self.part else ''}{self.part}"

    def open(self) -> None:
        """Make the folders, and clear what a killed sweep left half done.

        Raises
        ------
        InputError : the folder cannot be written.
        ComputationError : its disk is full.
        """
        try:
            for name in _FOLDERS:
                (self.folder / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise unwritable(self.folder, error) from error
        check_writable(self.folder / RESULTS)

    def clear(self) -> None:
        """Remove what a killed sweep left half done. Needs the folder's lock."""
        self.drop_operators()
        self.stopped.unlink(missing_ok=True)
        if not self.part:
            left = [*self.folder.glob("STOPPED.*"), *self.folder.glob("*.tmp*")]
            for path in (*left, *(self.folder / "inflight").glob("*.tmp*")):
                path.unlink(missing_ok=True)

    def drop_operators(self) -> None:
        """Remove the operators, which are assembled again where they are needed."""
        for path in (self.folder / "operators").glob(f"{self.part or '*'}_*"):
            path.unlink(missing_ok=True)

    @telling_unreadable()
    def scan(self, ids: Collection[str], mend: bool) -> tuple[dict[str, Entry], list[str]]:
        """Return the stored cases by id, and sentences on what is damaged. Needs the lock.

        Parameters
        ----------
        ids : of the cases of the study, whose checkpoints have to be theirs.
        mend : move damaged files aside, drop damaged rows.

        Raises
        ------
        ComputationError : a file is in use by a process of a killed sweep, or cannot be read.
        """
        entries: dict[str, Entry] = {}
        notes, mine = [], frozenset(ids)
        results = self.folder / RESULTS
        if results.exists():
            found = dataset.read_entries(results)
            if found is None:
                notes.append(self.set_aside(results, mend))
            entries.update(found or {})
        for path in sorted((self.folder / "shards").glob(f"{self.part or '*'}_*.sqlite")):
            index = shards.read_index(path)
            if index is None:
                notes.append(self.set_aside(path, mend))
                continue
            if index[1]:
                aside = _free_name(path)
                if mend:
                    shutil.copy(path, aside)
                    shards.drop_damaged_rows(path)
                notes.append(
                    f"{path}: {index[1]} of its rows are damaged (kept in {aside.name}); their "
                    "cases run again"
                )
            for identity, entry in index[0].items():  # a failure never hides a success
                if entries.get(identity, _NOTHING).status != "done":
                    entries[identity] = entry
        for path in sorted((self.folder / "inflight").glob("*.h5")):
            if entries.get(path.stem, _NOTHING).status not in ("done", "failed"):
                try:
                    record = _interrupted(path)
                    if path.stem in mine and _id_of(record) != path.stem:
                        raise InputError(f"{path}: is of another case than its name says")
                    entries[path.stem] = _entry(record, path)
                except UnreadableError:
                    raise
                except InputError as error:
                    if path.exists():  # else another slice has just ended the case
                        if mend:
                            path.unlink(missing_ok=True)
                        notes.append(f"{error}; this case starts anew")
        return entries, notes

    def set_aside(self, path: Path, mend: bool = True) -> str:
        """Give a damaged file another name, which no file has, and return a sentence on it.

        Parameters
        ----------
        mend : False: return the sentence only.
        """
        aside = _free_name(path)
        if mend:
            for tail in ("", "-wal", "-journal", "-shm"):  # those of SQLite
                with suppress(FileNotFoundError):  # there is none, or another slice was first
                    Path(f"{path}{tail}").replace(f"{aside}{tail}")
        return f"{path}: is damaged (kept as {aside.name}); its cases run again"

    def fetch(self, rows: Sequence[Row]) -> Iterator[Record]:
        """Yield the records of stored cases, in any order.

        Raises
        ------
        DamagedError : a file that the scan took for whole.
        ComputationError, UnreadableError : a file cannot be read now.
        """
        places: dict[Path, list[str]] = defaultdict(list)
        for row in rows:
            if row.entry is not None:
                places[row.entry.path].append(row.id)
        for path, ids in places.items():
            try:
                if path.suffix == ".sqlite":
                    yield from shards.read_records(path, ids)
                elif path.name == RESULTS:
                    yield from dataset.read_records(path, ids)
                else:
                    yield _interrupted(path)
            except UnreadableError:
                raise
            except _DAMAGE as error:
                if isinstance(error, sqlite3.DatabaseError) and not shards.is_damage(error):
                    raise ComputationError(f"{path}: cannot be read: {error}") from error
                raise DamagedError(path) from error

    def forget_shards(self) -> None:
        """Remove what results.h5 holds by now, and what slices have left."""
        for path in (self.folder / "shards").glob("*.sqlite*"):
            path.unlink(missing_ok=True)
        shards.forget_slices(self.folder)
        for name in _FOLDERS:  # what is damaged or interrupted stays
            with suppress(OSError):
                (self.folder / name).rmdir()


class DamagedError(ComputationError):
    """A file whose contents cannot be read.

    Parameters
    ----------
    path : of the file.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path}: is damaged")
        self.path = path


def _free_name(path: Path) -> Path:
    """Return a name for a damaged file, which no file has."""
    ending = path.suffix if path.name == RESULTS else ""
    numbers = chain([""], count(2))
    names = (path.with_name(f"{path.stem}.damaged{number}{ending}") for number in numbers)
    return next(name for name in names if not name.exists())


_NOTHING = Entry("", 0, 0, (), False, Path(), "")
#: what reading a damaged file ends in
_DAMAGE = (
    sqlite3.DatabaseError, RuntimeError, KeyError, IndexError, TypeError, ValueError, InputError,
)  # fmt: skip


def _entry(record: Record, path: Path) -> Entry:
    """Return what is known of an interrupted case."""
    fields = tuple(name for name in PROFILES if name in record.arrays)
    deep = any(record.arrays[name].ndim == 2 for name in fields)
    steps, elements = (len(record.arrays[name]) for name in ("time", "r"))
    return Entry(record.status, steps, elements, fields, deep, path, record.version)


def _interrupted(path: Path) -> Record:
    """Read an interrupted case.

    Raises
    ------
    InputError : the file is damaged, or cannot be read.
    """
    result = open_result(path)
    try:
        restored(result)
        about, worst = result.attributes, Balances(**result.balances).worst
        seconds, version = float(about["seconds_stepping"]), str(about["version"])
        arrays = {
            "step": result.step,
            **result.histories,
            "r": result.line.r,
            "width": result.line.width,
            **result.profiles,
        }
    except _DAMAGE as error:
        raise InputError(f"{path}: is damaged") from error
    return Record(path.stem, result.case, "incomplete", "", seconds, worst, arrays, version)


def _id_of(record: Record) -> str:
    """Return the id that the text of a case says, "" if it says none."""
    try:
        return case_id(read_keys(record.toml))
    except _DAMAGE:
        return ""
