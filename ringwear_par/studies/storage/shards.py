"""Shards: the cases of a sweep at work, one file a team, blocks of cases end to end.

Blocks are added at the end, and never changed. A case is done once its block is written: a process
that is killed loses the block that it was writing; a power failure can take the blocks of the last
second. The headers of the blocks are the index (see ``blocks``).
"""

import fcntl
import mmap
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from ringwear_par.errors import ComputationError
from ringwear_par.files.writing import atomic_write, open_or_make
from ringwear_par.studies.storage.blocks import (
    MARKER,
    Block,
    DamagedError,
    PackedBlock,
    is_torn,
    unpack_header,
)

_SYNC_SECONDS = 1.0
#: how long to wait for processes of a killed sweep to end, and between two looks
_BUSY_SECONDS, _NAP_SECONDS = 5.0, 0.05


def _lock(file: BinaryIO, path: Path, kind: int) -> None:
    """Lock a shard for as long as it is open; ComputationError where another process has it."""
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
    """Say why a shard cannot be written (ComputationError)."""
    try:
        yield
    except OSError as error:
        raise ComputationError(f"{path}: cannot be written: {error.strerror or error}") from error


class Shard:
    """The file that a team adds its cases to, made if it is not there; a context manager."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with _reporting_unwritable(path), ExitStack() as at_failure:
            self._file = open_or_make(path)
            at_failure.callback(self._file.close)
            _lock(self._file, path, fcntl.LOCK_EX)
            self._end = os.fstat(self._file.fileno()).st_size
            at_failure.pop_all()
        self._synced = time.monotonic()

    def add(self, block: Block) -> None:
        """Store cases for good: all of them, or none if the process is killed meanwhile."""
        with _reporting_unwritable(self.path):
            at, handle = self._end, self._file.fileno()
            try:
                for part in block.packed():
                    while part:
                        written = os.pwrite(handle, part, at)
                        part, at = part[written:], at + written
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


class ShardContents(NamedTuple):
    """The cases of a shard."""

    #: its good ones
    blocks: tuple[PackedBlock, ...]
    #: how many stretches of the file are no good blocks
    damaged: int
    #: where the last good block ends; behind it, if anything, is one that was cut off
    end: int


def read_shard(path: Path) -> ShardContents | None:
    """Return the cases of a shard, by the headers of its blocks; None if there is none in it.

    Not collective. An empty file holds no case: its sweep was killed before the first.
    """
    if not path.is_file():  # a pipe may keep its reader waiting
        return None
    blocks: list[PackedBlock] = []
    damaged = end = at = 0
    try:
        with path.open("rb") as file, _mapped(file, path) as content:
            while at < len(content):
                block = unpack_header(content, at, path)
                if block is not None:
                    damaged += at > end
                    blocks.append(block)
                    at = end = block.stop
                else:
                    at = content.find(MARKER, at + 1)
                    if at < 0:
                        damaged += not is_torn(content[end:])
                        break
    except OSError as error:
        raise ComputationError(f"{path}: cannot be read: {error.strerror or error}") from error
    return None if damaged and not blocks else ShardContents(tuple(blocks), damaged, end)


@contextmanager
def _mapped(file: BinaryIO, path: Path) -> Iterator[Any]:
    """Yield the contents of a shard, locked, without reading them."""
    _lock(file, path, fcntl.LOCK_SH)
    if not os.fstat(file.fileno()).st_size:  # nothing is mapped of an empty file
        yield b""
        return
    with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        yield content


def cut(path: Path, end: int) -> None:
    """Cut off a block without end, which a killed process was writing."""
    with _reporting_unwritable(path):
        os.truncate(path, end)


def drop_damaged_blocks(path: Path, copy: Path) -> bool:
    """Leave of a shard its good blocks, and a copy; tell whether there was more. Not collective."""
    contents, good = read_shard(path), list[PackedBlock]()
    for block in contents.blocks if contents is not None else ():
        with suppress(DamagedError):  # of its data
            block.check()
            good.append(block)
    if sum(block.stop - block.begin for block in good) == path.stat().st_size:
        return False
    with _reporting_unwritable(path):
        shutil.copy(path, copy)
        with copy.open("rb") as source, atomic_write(path) as name, name.open("wb") as target:
            for block in good:
                source.seek(block.begin)
                target.write(source.read(block.stop - block.begin))
    return True
