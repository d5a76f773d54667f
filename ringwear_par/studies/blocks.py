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
from collections import defaultdict
from collections.abc import Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import IntArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.bem.boundary import count_elements
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.errors import InputError, reason_of
from ringwear_par.history.elastic.bodies import operator_key
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.refusals.cases import check_memory, check_mesh
from ringwear_par.parallel import together
from ringwear_par.results.hdf5 import UnreadableError, atomic_hdf5, reading
from ringwear_par.results.variables import LINE
from ringwear_par.studies.ensemble import SOFTWARE, join_flags
from ringwear_par.studies.stored_variables import FIELDS, STORED, has_layers
from ringwear_par.studies.study import Study
from ringwear_par.studies.together import Computed, computed, most_together
from ringwear_par.version import __version__

log = logging.getLogger(__name__)

#: folder of the blocks, in that of the sweep
FOLDER = "blocks"
FILE_KIND = "a block of a sweep"
#: how variables are compressed
PACKED = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
#: share of padding above which they are compressed in a block, too, which is gone once it is merged
_MUCH_PADDING = 0.25
#: s, between two looks whether others have ended, while they are at work on the last blocks
_SHORTEST_NAP, _LONGEST_NAP = 0.01, 2.0
#: contact pairs that a rank keeps for its next block
_MOST_PAIRS = 16


@dataclass(frozen=True, eq=False)
class Block:
    """Cases that are computed and stored together."""

    #: of its file, named by its content
    path: Path
    #: of the cases in the study
    numbers: IntArray


def blocks_of(study: Study, folder: Path) -> list[Block]:
    """Return the blocks of a study in the folder of a sweep, the same on all ranks."""
    first = study.a_case()
    n = sum(count_elements(first.section(r), first.contact, first.mesh) for r in first.rings)
    assembly = 0.04 * (n / 318.0) ** 2 + 0.006 * (n / 318.0) ** 3  # s: n^2 elements, n^3 factors
    size = most_together(first, assembly * (study.shapes.max() + 1) / len(study))
    parts = np.split(study.order, range(size, len(study), size))
    return [Block(folder / FOLDER / f"{study.digest(part)}.h5", part) for part in parts]


# -- who computes which ------------------------------------------------------------------------


def free_blocks(blocks: Sequence[Block], share: int, shares: int) -> Iterator[Block]:
    """Yield blocks that are not there and that nobody is at work on, until all are there.

    Each is locked until the next is asked for. At the end this waits for those of others, and takes
    over what a killed process had locked. Where the disk has no locks: the blocks of a share.

    Parameters
    ----------
    share, shares : number of this team of ranks, and how many there are.
    """
    first = len(blocks) * share // shares
    left, nap = [*blocks[first:], *blocks[:first]], _SHORTEST_NAP
    while left:
        at_work = []
        for block in left:
            if block.path.exists():
                continue
            try:
                lock = block.path.with_suffix(".lock").open("w")
            except FileNotFoundError:  # another process has merged all blocks
                return
            with lock:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    at_work.append(block)
                    continue
                except OSError:
                    log.warning("%s: has no locks; each rank computes its share", lock.name)
                    yield from (b for b in blocks[share::shares] if not b.path.exists())
                    return
                try:
                    if not block.path.exists():
                        nap = _SHORTEST_NAP
                        yield block
                finally:
                    Path(lock.name).unlink(missing_ok=True)
        left = at_work
        if left:
            time.sleep(nap)
            nap = min(2.0 * nap, _LONGEST_NAP)


# -- a block is computed -----------------------------------------------------------------------


def pair_of(case: Case, pairs: dict[Hashable, ContactPair], comm: MPI.Comm) -> ContactPair:
    """Return the contact pair of a case, one of those that are there, or a new one among them.

    Collective on comm.

    Raises
    ------
    Exception : it cannot be assembled.
    """
    key = operator_key(case)
    if key not in pairs:
        check_memory(case, comm.size, "case")
        check_mesh(case, "case")
        while len(pairs) >= _MOST_PAIRS:
            del pairs[next(iter(pairs))]
        with together(comm):
            pairs[key] = assemble(case, comm)
    return pairs[key]


def compute(
    study: Study, block: Block, pairs: dict[Hashable, ContactPair], comm: MPI.Comm
) -> dict[str, Any]:
    """Return all that is stored of a block's cases, by name, (cases, ...). Collective on comm.

    Failed cases are among them, with their reasons.

    Parameters
    ----------
    pairs : contact pairs of earlier blocks; some of this one are added.
    """
    cases = study.cases_of(block.numbers)
    errors: dict[int, Exception] = {
        i: case for i, case in enumerate(cases) if isinstance(case, InputError)
    }
    of_pairs: dict[Hashable, list[int]] = defaultdict(list)
    for i, case in enumerate(cases):
        if isinstance(case, Case):
            of_pairs[operator_key(case)].append(i)
    parts: list[tuple[IntArray, Computed]] = []
    for numbers in of_pairs.values():
        chosen: list[Any] = [cases[i] for i in numbers]
        try:
            pair = pair_of(chosen[0], pairs, comm)
            done = computed(chosen, [pair] * len(chosen), comm)
        except Exception as error:  # the same for all of them
            errors |= dict.fromkeys(numbers, error)
            continue
        parts += [(np.array(numbers)[[*part.numbers]], part) for part in done]
    arrays = _arrays(cases, parts, errors)
    good = np.array([isinstance(case, Case) for case in cases])
    ids = np.array([f"{number:016x}" for number in block.numbers.tolist()], dtype="S16")
    ids[good] = study.ids(block.numbers[good])
    return {"case": ids, "number": block.numbers, **arrays}


def _arrays(
    cases: Sequence[Any],
    parts: Sequence[tuple[IntArray, Computed]],
    errors: Mapping[int, Exception],
) -> dict[str, Any]:
    """Return what is stored of cases but their names: those of parts, and those without."""
    count = len(cases)
    status, flags = ["failed"] * count, [""] * count
    reasons = [reason_of(errors[i]) if i in errors else "" for i in range(count)]
    arrays: dict[str, Any] = {
        "steps_stored": np.zeros(count, dtype=np.int64),
        "elements": np.zeros(count, dtype=np.int64),
        "seconds": np.zeros(count), "imbalance": np.zeros(count),
    }  # fmt: skip
    tables: list[tuple[IntArray, dict[str, Any]]] = []
    for at, part in parts:
        columns = part.columns
        rows, line = np.diff(columns.offsets), cases[at[0]].line
        for i, place in enumerate(at.tolist()):
            status[place], reasons[place] = columns.status[i], columns.reason[i]
            flags[place] = join_flags(columns.flags[i])
        arrays["steps_stored"][at], arrays["elements"][at] = rows, np.where(rows, line.n, 0)
        arrays["seconds"][at], arrays["imbalance"][at] = columns.seconds, columns.imbalance
        stored = np.arange(rows.max(initial=1)) < rows[:, None]
        tables_of_part = {
            name: np.broadcast_to(getattr(line, name), (len(rows), line.n)) for name in LINE
        }
        for group in (columns.histories, columns.layers, columns.stress, columns.profiles):
            for name, values in group.items():
                table = values = np.asarray(values, dtype=float)
                if name not in FIELDS or columns.deep:
                    table = np.full((*stored.shape, *values.shape[1:]), np.nan)
                    table[stored] = values
                tables_of_part[name] = table
        tables.append((at, {**tables_of_part, **columns.whole}))
    axes, sizes = axes_of([table for _, of_part in tables for table in of_part.items()])
    for name, dimensions in axes.items():
        arrays[name] = np.full((count, *(sizes[axis] for axis in dimensions)), np.nan)
        for at, of_part in tables:
            if name in of_part:
                put(name, arrays[name], at, of_part[name], arrays["steps_stored"][at])
    texts = {"status": status, "error": reasons, "flags": flags}
    return arrays | {name: np.array([t.encode() for t in v]) for name, v in texts.items()}


def axes_of(
    tables: Sequence[tuple[str, Any]],
) -> tuple[dict[str, tuple[str, ...]], dict[str, int]]:
    """Return the axes but that of cases of variables by name, and the sizes of all axes.

    Such that all of some tables (cases, ...) go into them; fields may be without steps.
    """
    axes: dict[str, tuple[str, ...]] = {}
    sizes: dict[str, int] = {}
    for name, table in tables:
        dimensions = STORED[name].dimensions[len(STORED[name].dimensions) + 1 - table.ndim :]
        axes[name] = max(axes.get(name, ()), dimensions, key=len)
        for axis, size in zip(dimensions, table.shape[1:], strict=True):
            sizes[axis] = max(sizes.get(axis, 0), size)
    return axes, sizes


def put(name: str, table: Any, at: IntArray | slice, values: Any, rows: IntArray) -> None:
    """Put values of some cases into a table (cases, ...) of more cases, steps or elements.

    Parameters
    ----------
    at : places of these cases in the table.
    rows : their stored states; of fields that are stored at the last one only it takes that.
    """
    if has_layers(STORED[name]) and values.shape[-1] < table.shape[-1]:
        layers = values.shape[-1] - 1
        put(name, table[..., :layers], at, values[..., :-1], rows)
        table, values = table[..., -1:], values[..., -1:]  # the body itself is the last
    cells = tuple(map(slice, values.shape[1:]))
    if values.ndim < table.ndim:
        table[(np.arange(len(table))[at], rows - 1, *cells)] = values
    else:
        table[(at, *cells)] = values


# -- a block's file ----------------------------------------------------------------------------


def write_block(block: Block, arrays: Mapping[str, Any]) -> None:
    """Write the file of a block. On one rank.

    Raises
    ------
    OSError : the disk.
    """
    with atomic_hdf5(block.path) as file:
        failed = int((arrays["status"] == b"failed").sum())
        file.attrs.update(software=SOFTWARE, version=__version__, failed=failed)
        for name, values in arrays.items():
            padded = values.dtype.kind == "f" and np.isnan(values).mean() > _MUCH_PADDING
            how: dict[str, Any] = PACKED if padded else {"fletcher32": True}
            file.create_dataset(name, data=values, **how)
            file[name].attrs.update(STORED[name].attributes if name in STORED else {})


def has_failed(block: Block) -> bool:
    """Tell whether a block is there, and some of its cases have failed. On one rank."""
    with suppress(InputError), reading(block.path, SOFTWARE, FILE_KIND) as file:
        return bool(file.attrs["failed"])
    return False


class DamagedError(Exception):
    """A block whose file is not whole."""

    def __init__(self, block: Block) -> None:
        super().__init__(f"{block.path}: is damaged")
        self.block = block


@contextmanager
def opened(block: Block) -> Iterator[h5py.File]:
    """Yield the file of a block to read. On one rank.

    Raises
    ------
    DamagedError : it is not whole; UnreadableError : the disk.
    """
    try:
        with reading(block.path, SOFTWARE, FILE_KIND) as file:
            yield file
    except UnreadableError:
        raise
    except InputError as error:
        raise DamagedError(block) from error
