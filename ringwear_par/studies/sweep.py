"""``ringwear sweep``: every case of a study, on all ranks, in blocks that are never lost.

What happens, see ``blocks``: the study is cut into blocks; each team of ranks computes those that
are free, and stores each by rename; once all are there one process merges them into ``results.h5``
and ``cases.csv``. Killed, stopped or started several times at once, the same command goes on.
"""

import fcntl
import shutil
import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.errors import ComputationError, InputError, RingwearError, counted
from ringwear_par.files.folders import check_folder, refuse_others
from ringwear_par.parallel import on_first_rank, peak_memory, together, warn_of_threads
from ringwear_par.results.files import reading
from ringwear_par.results.progress import Progress, duration
from ringwear_par.studies.blocks import FOLDER, Block, blocks_of, free_blocks, there
from ringwear_par.studies.ensemble import FILE_KIND, RESULTS, SOFTWARE, TABLE, count_flags
from ringwear_par.studies.many import computed
from ringwear_par.studies.results_file import arrays_of, is_merged, merge, write_block
from ringwear_par.studies.study import Study, read_study

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
    """What the ranks of a sweep have in common."""

    study: Study
    blocks: Sequence[Block]
    folder: Path
    comm: MPI.Intracomm
    #: ranks that share each case
    ranks_per_case: int


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

    def read() -> tuple[Study, list[Block]]:
        if ranks_per_case < 1 or comm.size % ranks_per_case:
            raise InputError(
                f"--ranks-per-case {ranks_per_case}: must be a divisor of the {comm.size} ranks"
            )
        refuse_others(folder, "sweep")
        study = source if isinstance(source, Study) else read_study(source, ranks_per_case)
        blocks, results = blocks_of(study, folder), folder / RESULTS
        merged = is_merged(folder, blocks)
        if not merged:
            check_folder(folder, (RESULTS, TABLE), "sweep")
            stored = [*folder.glob(f"{FOLDER}/*.h5")]
            if results.exists() or (stored and not there(blocks)):
                raise InputError(f"{folder}: holds cases of another study; must be a new folder")
        for path in filter(_has_failed, [block.path for block in blocks if retry]):
            path.unlink()
            results.unlink(missing_ok=True)
        if not merged or not results.exists():
            (folder / FOLDER).mkdir(parents=True, exist_ok=True)
        warn_of_threads(comm.size)
        return study, blocks

    return _Work(*on_first_rank(comm, read), folder, comm, ranks_per_case)


def _has_failed(path: Path) -> bool:
    """Tell whether a block, or the results, are there and some cases have failed. On one rank."""
    with suppress(InputError), reading(path, SOFTWARE, FILE_KIND) as file:
        return bool((file["status"][:] == b"failed").any())
    return False


# -- work ------------------------------------------------------------------------------------------


def _complete(work: _Work, say: Callable[[Summary], None] | None = None) -> Summary:
    """Compute the blocks that are not there, and merge them. Collective on work.comm.

    Raises
    ------
    InputError, ComputationError : a block cannot be read, the disk; cases failed.
    """
    count, started, blocks = 0, time.perf_counter(), work.blocks
    try:
        while not on_first_rank(work.comm, lambda: _merge(work)):
            count += _compute(work)
    except InputError:
        raise
    except (KeyboardInterrupt, RingwearError) as end:
        there_are = f"{there(blocks)} of {len(blocks)} blocks are there"
        sentence = f"{str(end) or 'Ctrl-C'}; {there_are}, and the same command goes on"
        if isinstance(end, KeyboardInterrupt):
            raise KeyboardInterrupt(sentence) from None
        with together(work.comm):
            raise ComputationError(sentence) from end
    seconds = time.perf_counter() - started
    summary = on_first_rank(work.comm, lambda: _summary(work, count, seconds))
    if say is not None:
        say(summary)
    if summary.failed:
        counts = f"{summary.failed} of {summary.total} cases failed"
        with together(work.comm):
            raise ComputationError(f"{counts}; {work.folder / TABLE} says why of each")
    return summary


def _compute(work: _Work) -> int:
    """Compute free blocks until all are there; return how many cases. Collective on work.comm.

    Where the disk fails one team, the others go on.
    """
    comm, blocks, ranks = work.comm, work.blocks, work.ranks_per_case
    team, share, shares = comm.Split(comm.rank // ranks), comm.rank // ranks, comm.size // ranks
    pairs: dict[Hashable, ContactPair] = {}
    cases, before, started = 0, there(blocks), time.perf_counter()
    bar = closing(Progress(len(blocks), before, silent=comm.rank > 0))
    with together(comm), closing(free_blocks(blocks, share, shares)) as free, bar as progress:
        while (block := on_first_rank(team, lambda: next(free, None))) is not None:
            _compute_block(work.study, block, pairs, team)
            cases += len(block.numbers) * (team.rank == 0)
            if progress.is_due():
                done, count = there(blocks), len(blocks)
                pace = (time.perf_counter() - started) / max(done - before, 1)
                left = duration((count - done) * pace)
                progress.show(done, "%d of %d blocks are there, %s left", done, count, left)
    team.Free()
    return comm.allreduce(cases)


def _compute_block(
    study: Study, block: Block, pairs: dict[Hashable, ContactPair], comm: MPI.Comm
) -> None:
    """Compute a block's cases and store them, failed ones with their reasons. Collective on comm.

    Contact pairs are those of the block before, and then those of this one.
    """
    cases = study.cases_of(block.numbers)
    parts, errors = computed(cases, pairs, comm)
    histories = [(np.array(p.numbers), p.recorder.columns(p.failures)) for p in parts]

    def store() -> None:
        about = {"case": study.ids(block.numbers), "number": block.numbers}
        write_block(block, about | arrays_of(cases, histories, errors))

    on_first_rank(comm, store)


def _merge(work: _Work) -> bool:
    """Merge all blocks, unless another process has; return whether there are results. On rank 0."""
    blocks, folder = work.blocks, work.folder / FOLDER
    try:
        lock = (folder / "merge.lock").open("w")
    except FileNotFoundError:  # another process has merged them
        return True
    with lock:
        with suppress(OSError):  # there are no locks
            fcntl.flock(lock, fcntl.LOCK_EX)
        if is_merged(work.folder, blocks):
            return True
        if there(blocks) < len(blocks):
            return False
        try:
            merge(work.study, blocks, work.folder, work.comm.size)
        except InputError:
            if there(blocks) == len(blocks):
                raise
            return False  # a damaged one is computed anew
        if not _has_failed(work.folder / RESULTS):  # --retry-failed needs the blocks
            done = folder.with_name(f".{FOLDER}")
            shutil.rmtree(done, ignore_errors=True)
            folder.rename(done)  # in one step, for processes that still look
            shutil.rmtree(done, ignore_errors=True)
        return True


# -- what is said ----------------------------------------------------------------------------------


def _summary(work: _Work, computed: int, seconds: float) -> Summary:
    """Return what the results say of their cases. On one rank."""
    with reading(work.folder / RESULTS, SOFTWARE, FILE_KIND) as file:
        status, flags = file["status"][:], file["flags"].asstr()[:]
        worst = float(np.nanmax(file["imbalance"][:], initial=0.0))
    total, failed = len(status), int((status == b"failed").sum())
    lines = [f"cases: {total}, {total - failed} done, {failed} failed"]
    if computed:
        rate = f"{computed / seconds:.3g} a second"
        lines.append(f"{computed} computed in {duration(seconds)}, {rate}; ranks: {work.comm.size}")
    lines.append(f"largest error of balances (force, energy, contact): {worst:.1e}")
    if any(flags):
        lines.append(count_flags(flags))
    lines.append(f"{work.folder / TABLE}, {work.folder / RESULTS}")
    return Summary(total, total - failed, failed, computed, "\n".join(lines))


def _estimate(work: _Work) -> str:
    """Compute the first free block, which stays, and return about how long the others take.

    Collective on work.comm.
    """
    comm, blocks, started = work.comm, work.blocks, time.perf_counter()
    merged = on_first_rank(comm, lambda: is_merged(work.folder, blocks))
    free = comm.bcast([block for block in blocks if not (merged or block.path.exists())])
    cases, count = counted(len(work.study), "case"), counted(len(blocks), "block")
    text = f"{cases} in {count}, {len(blocks) - len(free)} there already"
    if not free:
        return text
    done, left = _compute(replace(work, blocks=free[:1])), len(free) - 1
    seconds = time.perf_counter() - started
    others = duration(float(f"{seconds * -(-left * work.ranks_per_case // comm.size):.2g}"))
    return (
        f"{text}\none block of {done} cases took {duration(seconds)}; it stays in "
        f"{work.folder / FOLDER}\nthe other {counted(left, 'block')} on "
        f"{counted(comm.size, 'rank')}: about {others}; memory of a rank: "
        f"{1e-6 * peak_memory():.0f} MB"
    )
