"""Blocks: the unit in which a sweep works, stores and goes on.

The cases of a study, ordered by contact pair, are cut into blocks of a fixed size, which depends on
the cases only, never on ranks. A block is named by its content, and is one HDF5 file that appears
by rename: it is there, whole, or it is not. To go on is to compute the blocks that are not there.

Nobody hands blocks out. Every team of ranks walks the list from its own share on; it locks what it
computes, and the system drops the locks of killed processes. Ranks of one job, jobs, and tasks of
an array are all the same; each ends when all blocks are there.
"""

import fcntl
import logging
import time
from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ringwear_par.arrays import IntArray
from ringwear_par.elasticity.bem.boundary import count_elements
from ringwear_par.studies.many import most_together
from ringwear_par.studies.study import Study

log = logging.getLogger(__name__)

#: folder of the blocks, in that of the sweep
FOLDER = "blocks"
#: s, between two looks whether others have ended, while they are at work on the last blocks
_SHORTEST_NAP, _LONGEST_NAP = 0.01, 2.0


@dataclass(frozen=True, eq=False)
class Block:
    """Cases that are computed and stored together."""

    #: of its file, named by its content
    path: Path
    #: of the cases in the study
    numbers: IntArray


def blocks_of(study: Study, folder: Path) -> list[Block]:
    """Return the blocks of a study in the folder of a sweep, the same on all ranks."""
    first = study.case(study.first)
    elements = sum(count_elements(first.section(r), first.contact, first.mesh) for r in first.rings)
    n = elements / 318.0  # to which the seconds are: all pairs of elements, and their factors
    assembly = 0.03 + 0.04 * n**2 + 0.006 * n**3
    most = most_together(first, assembly * (study.shapes.max() + 1) / len(study))
    parts = np.split(study.order, range(most, len(study), most))
    return [Block(folder / FOLDER / f"{study.digest(part)}.h5", part) for part in parts]


def there(blocks: Iterable[Block]) -> int:
    """Return how many blocks are there."""
    return sum(block.path.exists() for block in blocks)


# -- who computes which ------------------------------------------------------------------------


def free_blocks(blocks: Sequence[Block], share: int, shares: int) -> Generator[Block, None, None]:
    """Yield blocks that are not there and that nobody is at work on, until all are there.

    Each is locked until the next is asked for, or this is closed. In the end this waits for those
    of others, and takes over what a killed process had locked. Shares are those of teams of ranks:
    each begins with its own, and has no other where there are no locks.
    """
    first, nap = len(blocks) * share // shares, 0.0
    left = [*blocks[first:], *blocks[:first]]
    while left := [block for block in left if not block.path.exists()]:
        time.sleep(nap)
        nap = min(2.0 * nap + _SHORTEST_NAP, _LONGEST_NAP)
        for block in (one for one in left if not one.path.exists()):
            try:
                lock = block.path.with_suffix(".lock").open("w")
            except FileNotFoundError:  # another process has merged all blocks
                return
            with lock:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:  # another process is at work on it
                    continue
                except OSError:
                    log.warning("%s: has no locks; each rank computes its share", lock.name)
                    yield from (b for b in blocks[share::shares] if not b.path.exists())
                    return
                try:
                    if not block.path.exists():
                        nap = 0.0
                        yield block
                finally:
                    Path(lock.name).unlink(missing_ok=True)
