"""``ringwear sweep``: every case of a study, on all ranks, in blocks that are never lost.

What happens, see ``blocks``: the study is cut into blocks; each team of ranks computes those that
are free, and stores each by rename; once all are there one process merges them into ``results.h5``
and ``cases.csv``. Killed, stopped or started several times at once, the same command goes on.
"""

import fcntl
import logging
import shutil
import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.errors import ComputationError, InputError, RingwearError, counted
from ringwear_par.files.folders import refuse_others
from ringwear_par.files.writing import check_writable, unwritable
from ringwear_par.parallel import as_ours, on_first_rank, peak_memory, warn_of_threads
from ringwear_par.results.hdf5 import UnreadableError, reading
from ringwear_par.results.progress import Progress, duration
from ringwear_par.studies.block_files import DamagedError, has_failed, write_block
from ringwear_par.studies.blocks import FOLDER, Block, blocks_of, compute, free_blocks, there
from ringwear_par.studies.ensemble import (
    FILE_KIND,
    RESULTS,
    SOFTWARE,
    TABLE,
    count_flags,
    split_flags,
)
from ringwear_par.studies.results_file import is_merged, merge
from ringwear_par.studies.study import Study, read_study
from ringwear_par.version import __version__

log = logging.getLogger(__name__)

Source = Study | Path | str | Mapping[str, Any]


@dataclass(frozen=True)
class Summary:
    """How many cases a sweep has; the rest is in its folder. As a text: what the command prints."""

    #: cases of the study, those that are done and that have failed
    total: int
    done: int
    failed: int
    #: those that this sweep computed
    computed: int
    text: str

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class _Work:
    """What the ranks of a sweep have in common, and how far this one is."""

    study: Study
    blocks: Sequence[Block]
    folder: Path
    comm: MPI.Intracomm
    #: ranks that share each case
    ranks_per_case: int
    #: blocks that were there before
    before: int


def sweep(
    study: Source,
    folder: Path | str,
    comm: MPI.Intracomm | None = None,
    *,
    ranks_per_case: int = 1,
    retry_failed: bool = False,
) -> Summary:
    """Compute every case of a study, or go on with it. Collective on comm.

    Parameters
    ----------
    study : read already, or as ``read_study`` takes it; the same on all ranks.
    folder : of the results; made if it is not there.
    comm : communicator, the world's where none is given.
    ranks_per_case : ranks that share each case; must divide the number of ranks.
    retry_failed : compute blocks with failed cases again.

    Returns
    -------
    Summary : how many cases are ``total``, ``done`` and ``failed``; the rest is in the folder.

    Raises
    ------
    InputError : the study, the folder or the numbers, before any work.
    ComputationError : cases failed, or the disk.

    Examples
    --------
    >>> import ringwear_par as rw
    >>> vary = {"load.pressure": {"values": [60, 80]}}
    >>> rw.sweep({"case": "scripts/cases/paper.toml", "vary": vary}, "out").done
    2
    """
    comm = MPI.COMM_WORLD if comm is None else comm
    return _complete(_prepared(study, Path(folder), comm, ranks_per_case, retry_failed))


def run_sweep(
    study: Path,
    folder: Path,
    comm: MPI.Intracomm,
    *,
    ranks_per_case: int = 1,
    retry_failed: bool = False,
    dry_run: bool = False,
) -> None:
    """Compute a study and print the summary, or an estimate; see ``sweep``. Collective on comm."""
    work = _prepared(study, folder, comm, ranks_per_case, retry_failed)
    if dry_run:
        print(_estimate(work))
    else:
        _complete(work, print)


# -- before any work -------------------------------------------------------------------------------


def _prepared(
    source: Source, folder: Path, comm: MPI.Intracomm, ranks_per_case: int, retry: bool
) -> _Work:
    """Read the study and make the folder, or refuse them. Collective on comm."""

    def read() -> tuple[Study, list[Block], int]:
        if ranks_per_case < 1 or comm.size % ranks_per_case:
            sizes = ", ".join(str(d) for d in range(1, comm.size + 1) if comm.size % d == 0)
            raise InputError(
                f"--ranks-per-case {ranks_per_case}: {comm.size} ranks do not divide into teams "
                f"of {ranks_per_case}; must be one of {sizes}"
            )
        study = source if isinstance(source, Study) else read_study(source, ranks_per_case)
        blocks = blocks_of(study, folder)
        _prepare_folder(folder, blocks, retry)
        warn_of_threads(comm.size)
        return study, blocks, there(blocks)

    study, blocks, before = on_first_rank(comm, read)
    return _Work(study, blocks, folder, comm, ranks_per_case, before)


def _prepare_folder(folder: Path, blocks: Sequence[Block], retry: bool) -> None:
    """Make the folder, or look that it is of this study; remove what is to be computed again."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; must be a folder, or a new name")
    refuse_others(folder, "sweep")
    merged, paths = is_merged(folder, blocks), {block.path for block in blocks}
    results = folder / RESULTS
    stored = [results] if results.exists() else [*(folder / FOLDER).glob("*.h5")]
    if stored and not merged and not paths & set(stored):
        must = "; must be removed, or a new folder"
        with reading(stored[0], SOFTWARE, FILE_KIND, must) as file:
            version = str(file.attrs["version"])
        same = version == __version__
        whose = "another study" if same else f"version {version} of ringwear-par"
        raise InputError(f"{folder}: holds cases of {whose}; must be a new folder")
    if retry:
        for path in filter(has_failed, paths):
            path.unlink()
            results.unlink(missing_ok=True)
    if is_merged(folder, blocks):
        return
    try:
        (folder / FOLDER).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(folder, error) from error
    check_writable(results)


# -- work ------------------------------------------------------------------------------------------


def _complete(work: _Work, say: Callable[[Summary], None] = lambda _: None) -> Summary:
    """Compute the blocks that are not there, merge them, and say how many failed.

    Collective on work.comm.

    Raises
    ------
    ComputationError : cases failed, or the disk.
    """
    comm, started, computed = work.comm, time.perf_counter(), 0
    try:
        while True:
            if not on_first_rank(comm, lambda: is_merged(work.folder, work.blocks)):
                computed += comm.allreduce(_compute(work))
            if on_first_rank(comm, lambda: _merge(work)):
                break
    except KeyboardInterrupt as signal:
        raise KeyboardInterrupt(f"{str(signal) or 'Ctrl-C'}; {_goes_on(work)}") from None
    seconds = time.perf_counter() - started
    summary = on_first_rank(comm, lambda: _summary(work, computed, seconds))
    say(summary)
    if summary.failed:
        counts = f"{summary.failed} of {summary.total} cases failed"
        error = ComputationError(f"{counts}; {work.folder / TABLE} says why of each")
        error.ranks = comm.size
        raise error
    return summary


def _compute(work: _Work, most: float = np.inf) -> int:
    """Compute free blocks, at most so many a team, until no rank finds any more.

    Return how many cases, 0 on all ranks of a team but its first. Collective on work.comm.
    """
    comm, ranks = work.comm, work.ranks_per_case
    team, share, shares = comm.Split(comm.rank // ranks), comm.rank // ranks, comm.size // ranks
    progress = Progress(len(work.blocks), work.before) if comm.rank == 0 else None
    pairs: dict[Hashable, ContactPair] = {}
    error: RingwearError | None = None
    computed, started = 0, time.perf_counter()
    try:
        with closing(free_blocks(work.blocks, share, shares)) as free:
            while most > 0 and (block := on_first_rank(team, lambda: next(free, None))) is not None:
                arrays = compute(work.study, block, pairs, team)
                on_first_rank(team, partial(write_block, block.path, arrays))
                computed, most = computed + len(block.numbers), most - 1
                if progress is not None and progress.is_due():
                    done, count = there(work.blocks), len(work.blocks)
                    pace = (time.perf_counter() - started) / max(done - work.before, 1)
                    left = duration((count - done) * pace)
                    progress.show(done, "%d of %d blocks are there, %s left", done, count, left)
    except RingwearError as failure:  # of the disk: others go on as long as they can
        error = failure
    finally:
        first = team.rank == 0
        team.Free()
        if progress is not None:
            progress.close()
    errors = [failure for failure in comm.allgather(error) if failure is not None]
    if errors:
        raise _incomplete(work, errors[0])
    return computed if first else 0


def _goes_on(work: _Work) -> str:
    """Return the words for a sweep that ends before all is there."""
    count = f"{there(work.blocks)} of {len(work.blocks)}"
    return f"{count} blocks are there, and the same command goes on"


def _incomplete(work: _Work, error: RingwearError) -> RingwearError:
    """Return the error of a sweep that ends too soon, the same on all ranks."""
    if not isinstance(error, InputError):
        error = ComputationError(f"{error}; {_goes_on(work)}")
    error.ranks = work.comm.size
    return error


def _merge(work: _Work) -> bool:
    """Merge all blocks; False where one was damaged and is to be computed anew. On rank 0."""
    blocks, folder = work.blocks, work.folder / FOLDER
    with ExitStack() as locks:
        with suppress(OSError):  # another process has merged them, or there are no locks
            lock = locks.enter_context((folder / "merge.lock").open("w"))
            fcntl.flock(lock, fcntl.LOCK_EX)
        if is_merged(work.folder, blocks):
            return True
        if there(blocks) < len(blocks):
            raise ComputationError(f"others may be at work on the rest; {_goes_on(work)}")
        try:
            merge(work.study, blocks, work.folder, work.comm.size)
        except DamagedError as error:
            log.warning("%s: it is computed anew", error)
            error.path.unlink(missing_ok=True)
            return False
        except (OSError, ComputationError, UnreadableError) as error:
            raise _incomplete(work, as_ours(error)) from error
        if not any(has_failed(block.path) for block in blocks):  # --retry-failed needs these
            done = folder.with_name(f".{FOLDER}")
            shutil.rmtree(done, ignore_errors=True)
            folder.rename(done)  # in one step, for processes that still look
            shutil.rmtree(done, ignore_errors=True)
    return True


# -- what is said ----------------------------------------------------------------------------------


def _summary(work: _Work, computed: int, seconds: float) -> Summary:
    """Return what the results say of their cases. On one rank."""
    with reading(work.folder / RESULTS, SOFTWARE, FILE_KIND) as file:
        status, flags = file["status"][:], file["flags"][:]
        worst = float(np.nanmax(file["imbalance"][:], initial=0.0))
    total, failed = len(status), int((status == b"failed").sum())
    lines = [f"cases: {total}, {total - failed} done, {failed} failed"]
    if computed:
        rate = f"{computed / seconds:.3g} a second"
        lines.append(f"{computed} computed in {duration(seconds)}, {rate}; ranks: {work.comm.size}")
    lines.append(f"largest error of balances (force, energy, contact): {worst:.1e}")
    words, counts = np.unique(flags[flags != b""], return_counts=True)
    if len(words):
        flagged = zip((split_flags(word.decode()) for word in words), counts.tolist(), strict=True)
        lines.append(count_flags(dict(flagged)))
    lines.append(f"{work.folder / TABLE}, {work.folder / RESULTS}")
    return Summary(total, total - failed, failed, computed, "\n".join(lines))


def _estimate(work: _Work) -> str:
    """Compute the first free block, which stays, and return about how long the others take.

    Collective on work.comm.
    """
    comm, blocks, teams = work.comm, work.blocks, work.comm.size // work.ranks_per_case
    cases, count = counted(len(work.study), "case"), counted(len(blocks), "block")
    text, started = f"{cases} in {count}, {work.before} there already", time.perf_counter()
    if on_first_rank(comm, lambda: is_merged(work.folder, blocks)):
        return text
    done = comm.bcast(_compute(work, most=comm.rank < work.ranks_per_case))
    if not done:
        return text
    seconds, left = time.perf_counter() - started, len(blocks) - work.before - 1
    others = duration(float(f"{seconds * -(-left // teams):.2g}"))
    return (
        f"{text}\none block of {done} cases took {duration(seconds)}; it stays in "
        f"{work.folder / FOLDER}\nthe other {counted(left, 'block')} on "
        f"{counted(comm.size, 'rank')}: about {others}; memory of a rank: "
        f"{1e-6 * peak_memory():.0f} MB"
    )
