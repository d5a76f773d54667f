"""The folder of a sweep: which cases it holds, and where.

``results.h5`` and ``cases.csv`` are written when a sweep ends; until then its cases are in
``shards``, those that a stop interrupted in ``inflight``, shared operators in ``operators``. Slices
of a study keep to files of their own until the whole is merged.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.cases.files.keys import read_keys
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.files.writing import check_writable, remove_leftovers, unwritable
from ringwear_par.history.observers.balances import Balances
from ringwear_par.results.storage.checkpoints import restored
from ringwear_par.results.storage.hdf5 import UnreadableError
from ringwear_par.results.storage.result_files import open_result
from ringwear_par.results.stress_variables import point_columns, stress_rows
from ringwear_par.results.variables import TIMES_THROUGH
from ringwear_par.studies.definition.identities import case_id
from ringwear_par.studies.storage import results_file, shards
from ringwear_par.studies.storage.blocks import Block, Record, unpack_header
from ringwear_par.studies.storage.index import DAMAGE, INCOMPLETE, Index, join, latest
from ringwear_par.studies.storage.locks import forget_slices
from ringwear_par.studies.storage.results_file import RESULTS


@contextmanager
def reporting_unreadable() -> Iterator[None]:
    """Have a sweep fail where a file of its folder cannot be read now: that is no bad input."""
    try:
        yield
    except UnreadableError as error:
        raise ComputationError(str(error)) from error


#: how names of shards end
SHARD = ".blocks"
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
        return self.folder / "shards" / f"{self.part or 'all'}_{team:04d}{SHARD}"

    def inflight(self, identity: str) -> Path:
        """Return the file of a case that was interrupted."""
        return self.folder / "inflight" / f"{identity}.h5"

    def interrupted(self) -> list[Path]:
        """Return the files of all cases that were interrupted."""
        return sorted((self.folder / "inflight").glob("*.h5"))

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
            for path in self.folder.glob("STOPPED.*"):
                path.unlink(missing_ok=True)
            remove_leftovers(self.folder)
            remove_leftovers(self.folder / "inflight")

    def drop_operators(self) -> None:
        """Remove the operators, which are assembled again where they are needed."""
        for path in (self.folder / "operators").glob(f"{self.part or '*'}_*"):
            path.unlink(missing_ok=True)

    @reporting_unreadable()
    def scan(self, ids: Any, mend: bool) -> tuple[Index, list[str]]:
        """Return the stored cases, and sentences on what is damaged. Needs the lock.

        Parameters
        ----------
        ids : (cases,) bytes, of the study, whose checkpoints have to be theirs.
        mend : set damaged files and blocks aside, cut off what a killed process was writing.

        Raises
        ------
        ComputationError : a file is in use by a process of a killed sweep, or cannot be read.
        """
        parts: list[Index] = []
        notes = []
        results = self.folder / RESULTS
        if results.exists():
            index = results_file.read_entries(results)
            if index is None:
                notes.append(self.set_aside(results, mend))
            else:
                parts.append(index)
        for path in sorted((self.folder / "shards").glob(f"{self.part or '*'}_*{SHARD}")):
            contents = shards.read_shard(path)
            if contents is None:
                notes.append(self.set_aside(path, mend))
                continue
            if contents.damaged:
                notes.append(self.mend(path, mend))
            elif mend:
                shards.cut(path, contents.end)
            parts.append(contents.index)
        # a failure never hides a success
        stored = latest(join(parts))
        interrupted, more = self._in_flight(stored, ids, mend)
        return latest(join([stored, *interrupted])), notes + more

    def _in_flight(self, stored: Index, ids: Any, mend: bool) -> tuple[list[Index], list[str]]:
        """Return the interrupted cases that have not ended since, and what is damaged."""
        paths = self.interrupted()
        names = np.array([os.fsencode(path.stem) for path in paths] or [b""])[: len(paths)]
        entries, mine = stored.find(names), np.isin(names, ids)
        parts, notes = [], []
        for path, entry, own in zip(paths, entries.tolist(), mine.tolist(), strict=True):
            if entry >= 0 and stored["status"][entry] != INCOMPLETE:
                if mend:  # killed between storing the case and this
                    path.unlink(missing_ok=True)
                continue
            try:
                record = _interrupted(path)
                if own and _id_of(record) != path.stem:
                    raise InputError(f"{path}: is of another case than its name says")
                packed = Block.of([record]).packed()
                block = unpack_header(packed, 0, path, packed)
                assert block is not None
                parts.append(block[1])
            except UnreadableError:
                raise
            except InputError as error:
                if path.exists():  # else another slice has just ended the case
                    if mend:
                        path.unlink(missing_ok=True)
                    notes.append(f"{error}; this case starts anew")
        return parts, notes

    def mend(self, path: Path, mend: bool = True) -> str:
        """Drop what is damaged of a shard, or set another file aside; return a sentence on it.

        Parameters
        ----------
        mend : False: return the sentence only.
        """
        if path.suffix != SHARD:
            return self.set_aside(path, mend)
        copy = _free_name(path)
        if mend and not shards.drop_damaged_blocks(path, copy):
            return self.set_aside(path)
        return f"{path}: some of it is damaged (kept in {copy.name}); its cases run again"

    def set_aside(self, path: Path, mend: bool = True) -> str:
        """Give a damaged file another name, which no file has, and return a sentence on it.

        Parameters
        ----------
        mend : False: return the sentence only.
        """
        aside = _free_name(path)
        if mend:
            with suppress(FileNotFoundError):  # another slice was first
                path.replace(aside)
        return f"{path}: is damaged (kept as {aside.name}); its cases run again"

    def forget_shards(self) -> None:
        """Remove what results.h5 holds by now, and what slices have left."""
        for path in (self.folder / "shards").glob(f"*{SHARD}*"):
            path.unlink(missing_ok=True)
        forget_slices(self.folder)
        for name in _FOLDERS:  # what is damaged or interrupted stays
            with suppress(OSError):
                (self.folder / name).rmdir()


def _free_name(path: Path) -> Path:
    """Return a name for a damaged file, which no file has."""
    ending = path.suffix if path.name == RESULTS else ""
    numbers = chain([""], count(2))
    names = (path.with_name(f"{path.stem}.damaged{number}{ending}") for number in numbers)
    return next(name for name in names if not name.exists())


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
            **result.layers,
            **{name: np.array(about[name]) for name in TIMES_THROUGH if name in about},
        }
        if result.stress is not None:
            arrays |= stress_rows(result.stress, arrays["time"]) | point_columns(result.stress)
    except DAMAGE as error:
        raise InputError(f"{path}: is damaged") from error
    return Record(path.stem, result.case, "incomplete", "", seconds, worst, arrays, version)


def _id_of(record: Record) -> str:
    """Return the id that the text of a case says, "" if it says none."""
    try:
        return case_id(read_keys(record.toml))
    except DAMAGE:
        return ""
