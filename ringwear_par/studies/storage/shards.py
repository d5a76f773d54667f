"""What a sweep has computed while it is at work: one file a team, blocks of cases end to end.

Blocks are added at the end, and never changed. A case is done once its block is written: a process
that is killed loses the block that it was writing; what a power failure can take is what was
written in the last second. The headers of the blocks are the index (see ``blocks``).
"""

import fcntl
import mmap
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from ringwear_par.errors import ComputationError
from ringwear_par.files.ordinary import open_ordinary
from ringwear_par.files.writing import atomic_write
from ringwear_par.studies.storage.blocks import MARKER, Block, PackedBlock, is_torn, unpack_header
from ringwear_par.studies.storage.index import DamagedError, Index, join

_SYNC_SECONDS = 1.0
#: how long to wait for processes of a killed sweep to end, and between two looks
_BUSY_SECONDS, _NAP_SECONDS = 5.0, 0.05


def _lock(file: BinaryIO, path: Path, kind: int) -> None:
    """Lock a shard for as long as it is open.

    Raises
    ------
    ComputationError : another process has it.
    """
    limit = time.monotonic() + _BUSY_SECONDS
    while True:
        try:
            fcntl.flock(file, kind | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if time.monotonic() > limit:
                raise ComputationError(
                    f"{path}: is in use by a process of another sweep, perhaps one that was killed"
                ) from None
        time.sleep(_NAP_SECONDS)


@contextmanager
def _reporting_unwritable(path: Path) -> Iterator[None]:
    """Say why a shard cannot be written.

    Raises
    ------
    ComputationError : it cannot be.
    """
    try:
        yield
    except OSError as error:
        raise ComputationError(f"{path}: cannot be written: {error.strerror or error}") from error


class Shard:
    """The file that a team adds its cases to; a context manager.

    Parameters
    ----------
    path : made if it is not there.

    Raises
    ------
    ComputationError : the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with _reporting_unwritable(path), ExitStack() as at_failure:
            self._file = open_ordinary(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW)
            at_failure.callback(self._file.close)
            _lock(self._file, path, fcntl.LOCK_EX)
            self._end = os.fstat(self._file.fileno()).st_size
            at_failure.pop_all()
        self._synced = time.monotonic()

    def add(self, block: Block) -> None:
        """Store cases for good: all of them, or none if the process is killed meanwhile.

        Raises
        ------
        ComputationError : the disk, or somebody has removed the file.
        """
        with _reporting_unwritable(self.path):
            packed, at, handle = memoryview(block.packed()), self._end, self._file.fileno()
            try:
                while packed:
                    written = os.pwrite(handle, packed, at)
                    packed, at = packed[written:], at + written
            except BaseException:
                with suppress(OSError):
                    os.ftruncate(handle, self._end)
                raise
            self._end = at
            if time.monotonic() - self._synced > _SYNC_SECONDS:
                os.fsync(handle)
                self._synced = time.monotonic()
                if not self.path.exists():
                    raise ComputationError(f"{self.path}: was removed while it was written to")

    def close(self) -> None:
        """Bring everything to the disk."""
        with _reporting_unwritable(self.path), self._file:
            os.fsync(self._file.fileno())

    def __enter__(self) -> "Shard":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@dataclass(frozen=True, eq=False)
class ShardContents:
    """The cases of a shard.

    Parameters
    ----------
    index : of its good blocks.
    damaged : how many stretches of the file are no good blocks.
    end : where the last good block ends; behind it, if anything, is one that was cut off.
    """

    index: Index
    damaged: int
    end: int


def read_shard(path: Path) -> ShardContents | None:
    """Return the cases of a shard, by the headers of its blocks; None if there is none in it.

    Not collective. An empty file holds no case: its sweep was killed before the first.

    Raises
    ------
    ComputationError : it cannot be read.
    """
    if not path.is_file():  # a pipe may keep its reader waiting
        return None
    parts: list[Index] = []
    damaged = end = 0
    for begin, block in _scan(path):
        if isinstance(block, bytes):
            if is_torn(block):
                return ShardContents(join(parts), damaged, begin)
            damaged += 1
        else:
            parts.append(block[1])
            end = block[0].stop
    return None if damaged and not parts else ShardContents(join(parts), damaged, end)


def _scan(path: Path) -> Iterator[tuple[int, bytes | tuple[PackedBlock, Index]]]:
    """Yield where each block begins, with its index, and stretches that are none, in their order.

    Of these what tells whether they are the beginning of a block.
    """
    try:
        with open_ordinary(path) as file:
            _lock(file, path, fcntl.LOCK_SH)
            if not os.fstat(file.fileno()).st_size:
                return
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
                at = 0
                while at < len(content):
                    begin = at
                    while (block := unpack_header(content, at, path)) is None:
                        at = content.find(MARKER, at + 1)
                        if at < 0:
                            at = len(content)
                            break
                    if at > begin:
                        yield begin, content[begin:at] if block is None else b"\0"
                    if block is not None:
                        yield at, block
                        at = block[0].stop
    except OSError as error:
        raise ComputationError(f"{path}: cannot be read: {error.strerror or error}") from error


def cut(path: Path, end: int) -> None:
    """Cut off a block without end, which a killed process was writing.

    Raises
    ------
    ComputationError : the file cannot be written.
    """
    with _reporting_unwritable(path):
        os.truncate(path, end)


def drop_damaged_blocks(path: Path, copy: Path) -> bool:
    """Leave of a shard its good blocks alone; return whether there was anything else.

    Not collective.

    Parameters
    ----------
    copy : name of a copy of what there was.

    Raises
    ------
    ComputationError : the file cannot be read or written.
    """
    good, size = [], 0
    for begin, block in _scan(path):
        if not isinstance(block, bytes):
            with suppress(DamagedError):  # of its data
                block[0].check()
                good.append((begin, block[0].stop))
                size += block[0].stop - begin
    if size == path.stat().st_size:
        return False
    with _reporting_unwritable(path):
        shutil.copy(path, copy)
        with copy.open("rb") as source, atomic_write(path) as name, name.open("wb") as target:
            for begin, stop in good:
                source.seek(begin)
                target.write(source.read(stop - begin))
    return True
