"""The folder of a sweep: which cases it holds, and where; one sweep at a time is at work in it.

``results.h5`` and ``cases.csv`` are written when a sweep ends; until then its cases are in
``shards``, checkpoints of those that were interrupted in ``inflight``. Slices of a study have files
of their own until the whole is merged.
"""

import fcntl
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ringwear_par.errors import ComputationError, InputError
from ringwear_par.files.writing import check_writable, open_or_make, unwritable
from ringwear_par.results.hdf5 import UnreadableError
from ringwear_par.studies.storage import shards
from ringwear_par.studies.storage.blocks import INCOMPLETE, CaseBlock
from ringwear_par.studies.storage.case_index import CaseIndex
from ringwear_par.studies.storage.results_file import RESULTS, read_results_blocks


@contextmanager
def reporting_unreadable() -> Iterator[None]:
    """Have a sweep fail where a file of its folder cannot be read now: that is no bad input."""
    try:
        yield
    except UnreadableError as error:
        raise ComputationError(str(error)) from error


#: ending of names of shards
SHARD = ".blocks"
_FOLDERS = ("shards", "inflight")


@dataclass(frozen=True)
class SweepFolder:
    """The files of a sweep."""

    #: of the folder
    path: Path
    #: "" for the whole, or the slice, such as "2-8"
    part: str = ""

    def shard(self, team: int) -> Path:
        """Return the file that a team writes to."""
        return self.path / "shards" / f"{self.part or 'all'}_{team:04d}{SHARD}"

    def checkpoint(self, identity: str) -> Path:
        """Return the file that an interrupted case continues from."""
        return self.path / "inflight" / f"{identity}.h5"

    def checkpoints(self) -> list[Path]:
        """Return the files of all cases that were interrupted."""
        return sorted((self.path / "inflight").glob("*.h5"))

    @property
    def stopped(self) -> Path:
        """The file that is there after a stop: run the same command again."""
        return self.path / f"STOPPED{'.' if self.part else ''}{self.part}"

    def open(self) -> None:
        """Make the folders, and see that they can be written (InputError) to a disk with room."""
        try:
            for name in _FOLDERS:
                (self.path / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise unwritable(self.path, error) from error
        check_writable(self.path / RESULTS)

    def clear(self) -> None:
        """Remove marks of stopped sweeps and half files of killed ones. Needs the folder's lock."""
        self.stopped.unlink(missing_ok=True)
        for pattern in [] if self.part else ["STOPPED.*", ".*.tmp"]:
            for path in self.path.glob(pattern):
                path.unlink(missing_ok=True)

    # -- which cases it holds ----------------------------------------------------------------------

    @reporting_unreadable()
    def scan(self, mend: bool) -> tuple[CaseIndex, list[str]]:
        """Return the stored cases, and sentences on damage, which it may mend. Needs the lock.

        Damaged files and blocks are set aside, the half block of a killed process is cut off.
        ComputationError where a file is in use by such a process, or cannot be read.
        """
        blocks: list[CaseBlock] = []
        notes = []
        results = self.path / RESULTS
        if results.exists():
            stretches = read_results_blocks(results)
            if stretches is None:
                notes.append(self.set_aside(results, mend))
            else:
                blocks += stretches
        for path in sorted((self.path / "shards").glob(f"{self.part or '*'}_*{SHARD}")):
            contents = shards.read_shard(path)
            if contents is None:
                notes.append(self.set_aside(path, mend))
                continue
            if contents.damaged:
                notes.append(self.mend(path, mend))
            elif mend:
                shards.cut(path, contents.end)
            blocks += contents.blocks
        index = CaseIndex.of(blocks)
        if mend:
            self._drop_old_checkpoints(index)
        return index, notes

    def _drop_old_checkpoints(self, index: CaseIndex) -> None:
        """Remove those of cases that have ended: a sweep was killed just before it would."""
        names = [path.stem for path in self.checkpoints()]
        entries = index.find(np.array([os.fsencode(name) for name in names]))
        for name, entry in zip(names, entries.tolist(), strict=True):
            if entry >= 0 and index["status"][entry] != INCOMPLETE:
                self.checkpoint(name).unlink(missing_ok=True)

    def mend(self, path: Path, mend: bool = True) -> str:
        """Drop damaged blocks of a shard, or set a file aside, if at all; return a sentence."""
        if path.suffix != SHARD:
            return self.set_aside(path, mend)
        copy = _free_name(path)
        if mend and not shards.drop_damaged_blocks(path, copy):
            return self.set_aside(path)
        return f"{path}: some of it is damaged (kept in {copy.name}); its cases run again"

    def set_aside(self, path: Path, mend: bool = True) -> str:
        """Give a damaged file a name that no file has, if at all; return a sentence on it."""
        aside = _free_name(path)
        if mend:
            with suppress(FileNotFoundError):  # another slice was first
                path.replace(aside)
        return f"{path}: is damaged (kept as {aside.name}); its cases run again"

    def forget_shards(self) -> None:
        """Remove shards, which results.h5 holds by now, and locks of slices."""
        for path in (self.path / "shards").glob(f"*{SHARD}*"):
            path.unlink(missing_ok=True)
        forget_slices(self.path)
        for name in _FOLDERS:  # damaged files and checkpoints stay
            with suppress(OSError):
                (self.path / name).rmdir()


def _free_name(path: Path) -> Path:
    """Return a name for a damaged file, which no file has."""
    ending = path.suffix if path.name == RESULTS else ""
    numbers = chain([""], count(2))
    names = (path.with_name(f"{path.stem}.damaged{number}{ending}") for number in numbers)
    return next(name for name in names if not name.exists())


# -- locks -----------------------------------------------------------------------------------------


@contextmanager
def locked(folder: Path, part: str) -> Iterator[None]:
    """Lock a sweep's folder, or one slice of it, for this process. Call on one rank.

    The whole, "", excludes every slice. InputError where another sweep is at work.
    """
    with ExitStack() as locks:
        lock = locks.enter_context(_opened(folder / "lock"))
        _lock(lock, fcntl.LOCK_SH if part else fcntl.LOCK_EX, folder)
        if part:  # only now: who has the whole may remove it
            slice_lock = locks.enter_context(_opened(folder / f"lock{part}"))
            _lock(slice_lock, fcntl.LOCK_EX, folder)
        yield


def forget_slices(folder: Path) -> None:
    """Remove the locks of slices. Needs the lock of the whole folder."""
    for path in folder.glob("lock[0-9]*-[0-9]*"):
        path.unlink(missing_ok=True)


def _opened(path: Path) -> BinaryIO:
    """Open a lock, or make it; InputError where something else is there."""
    try:
        return open_or_make(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be opened: {error.strerror or error}") from error


def _lock(file: BinaryIO, kind: int, folder: Path) -> None:
    try:
        fcntl.flock(file, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(
            f"{folder}: another sweep is at work in this folder; wait for its end, or use another"
        ) from None
    except OSError as error:
        raise InputError(f"{folder}: its disk cannot lock files: {error.strerror}") from error
