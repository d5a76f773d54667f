"""``ringwear sweep``: every case of a study, on all ranks, in blocks that are never lost.

What happens, see ``blocks``: the study is cut into blocks; each team of ranks computes those that
are free, and stores each by rename; once all are there one process merges them into ``results.h5``
and ``cases.csv``. Killed, stopped or started several times at once, the same command goes on.
"""

import fcntl
import logging
import shutil
import time
from collections.abc import Hashable, Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.errors import ComputationError, InputError, RingwearError, counted
from ringwear_par.files.folders import refuse_others
from ringwear_par.files.writing import check_writable, unwritable
from ringwear_par.parallel import as_ours, on_first_rank, peak_memory, warn_of_threads
from ringwear_par.results.hdf5 import UnreadableError, reading
from ringwear_par.results.progress import Progress, duration
from ringwear_par.studies.block_files import DamagedError, has_failed, write_block
from ringwear_par.studies.blocks import FOLDER, Block, blocks_of, compute, free_blocks
from ringwear_par.studies.ensemble import FILE_KIND, RESULTS, SOFTWARE
from ringwear_par.studies.results_file import fingerprint, merge
from ringwear_par.studies.study import Study, read_study
from ringwear_par.studies.summary import Summary, stored_summary
from ringwear_par.version import __version__

log = logging.getLogger(__name__)

Source = Study | Path | str | Mapping[str, Any]


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
    summary = _Sweep(study, Path(folder), comm, ranks_per_case, retry_failed).run()
    summary.refuse_failures()
    return summary


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
    work = _Sweep(study, folder, comm, ranks_per_case, retry_failed)
    if dry_run:
        print(work.estimate())
        return
    summary = work.run()
    print(summary)
    summary.refuse_failures()


class _Sweep:
    """A sweep at work. Making one, and its methods, are collective on comm."""

    def __init__(
        self, source: Source, folder: Path, comm: MPI.Intracomm, ranks: int, retry: bool
    ) -> None:
        self._folder, self._comm, self._ranks = folder, comm, ranks
        self._started, self._computed, self._busy = time.perf_counter(), 0, 0.0

        def prepared() -> tuple[Study, list[Block]]:
            if ranks < 1 or comm.size % ranks:
                sizes = ", ".join(str(d) for d in range(1, comm.size + 1) if comm.size % d == 0)
                raise InputError(
                    f"--ranks-per-case {ranks}: {comm.size} ranks do not divide into teams of "
                    f"{ranks}; must be one of {sizes}"
                )
            study = source if isinstance(source, Study) else read_study(source, ranks)
            blocks = blocks_of(study, folder)
            _prepare(folder, blocks, retry)
            warn_of_threads(comm.size)
            return study, blocks

        self._study, self._blocks = on_first_rank(comm, prepared)
        self._team = comm.Split(comm.rank // ranks, comm.rank)
        self._share, self._shares = comm.rank // ranks, comm.size // ranks
        self._begun = self._there()

    def _there(self) -> int:
        """Return how many blocks are there."""
        return sum(block.path.exists() for block in self._blocks)

    def run(self) -> Summary:
        """Compute what is not there, and merge once all is."""
        try:
            while True:
                if not on_first_rank(self._comm, lambda: is_merged(self._folder, self._blocks)):
                    self._compute()
                if on_first_rank(self._comm, self._merge):
                    break
        except KeyboardInterrupt as signal:
            there = f"{self._there()} of {len(self._blocks)} blocks are there"
            name = str(signal) or "Ctrl-C"
            raise KeyboardInterrupt(f"{name}; {there}, and the same command goes on") from None
        finally:
            self._team.Free()
        comm = self._comm
        return replace(
            on_first_rank(comm, lambda: stored_summary(self._folder)),
            computed=comm.allreduce(self._computed), busy=comm.allreduce(self._busy),
            seconds=time.perf_counter() - self._started, ranks=comm.size,
            peak=1e-6 * comm.allreduce(peak_memory(), MPI.MAX),
        )  # fmt: skip

    def _compute(self, most: int | None = None) -> None:
        """Compute free blocks, at most so many a team, until no rank finds any more."""
        comm, team, progress = self._comm, self._team, None
        if comm.rank == 0:
            progress = Progress(len(self._blocks), self._begun)
        error: RingwearError | None = None
        pairs: dict[Hashable, ContactPair] = {}
        with closing(free_blocks(self._blocks, self._share, self._shares)) as free:
            while most is None or most > 0:
                try:
                    block = on_first_rank(team, lambda: next(free, None))
                    if block is None:
                        break
                    started = time.perf_counter()
                    arrays = compute(self._study, block, pairs, team)
                    on_first_rank(team, partial(write_block, block.path, arrays))
                except RingwearError as failure:  # of the disk: others go on as long as they can
                    error = failure
                    break
                if team.rank == 0:
                    self._computed += len(block.numbers)
                self._busy += time.perf_counter() - started
                most = None if most is None else most - 1
                if progress is not None and progress.is_due():
                    self._show(progress)
        if progress is not None:
            progress.close()
        errors = [failure for failure in comm.allgather(error) if failure is not None]
        if errors:
            raise self._incomplete(errors[0])

    def _show(self, progress: Progress) -> None:
        """Show how many blocks are there, and how long the others take."""
        there, spent = self._there(), time.perf_counter() - self._started
        left = (len(self._blocks) - there) * spent / max(there - self._begun, 1)
        text = "%d of %d blocks are there, %s left"
        progress.show(there, text, there, len(self._blocks), duration(left))

    def _incomplete(self, error: RingwearError) -> RingwearError:
        """Return the error of a sweep that ends too soon, the same on all ranks."""
        if not isinstance(error, InputError):
            error = ComputationError(
                f"{error}; {self._there()} of {len(self._blocks)} blocks are there, and the same "
                "command goes on"
            )
        error.ranks = self._comm.size
        return error

    def _merge(self) -> bool:
        """Merge all blocks; False where one was damaged and is to be computed anew. On rank 0."""
        blocks, folder = self._blocks, self._folder / FOLDER
        with ExitStack() as locks:
            with suppress(OSError):  # another process has merged them, or there are no locks
                lock = locks.enter_context((folder / "merge.lock").open("w"))
                fcntl.flock(lock, fcntl.LOCK_EX)
            if is_merged(self._folder, blocks):
                return True
            if (there := self._there()) < len(blocks):
                raise ComputationError(
                    f"{there} of {len(blocks)} blocks are there, others may be at work on the "
                    "rest; the same command goes on, and merges them"
                )
            try:
                merge(self._study, blocks, self._folder, self._comm.size)
            except DamagedError as error:
                log.warning("%s: it is computed anew", error)
                error.path.unlink(missing_ok=True)
                return False
            except (OSError, UnreadableError) as error:
                raise self._incomplete(as_ours(error)) from error
            if not any(has_failed(block.path) for block in blocks):  # --retry-failed needs these
                done = folder.with_name(f".{FOLDER}")
                shutil.rmtree(done, ignore_errors=True)
                folder.rename(done)  # in one step, for processes that still look
                shutil.rmtree(done, ignore_errors=True)
        return True

    def estimate(self) -> str:
        """Compute the first free block, which stays, and return about how long the others take."""
        blocks, study = self._blocks, self._study
        cases, count = counted(len(study), "case"), counted(len(blocks), "block")
        lines = [f"{cases} in {count}, {self._begun} there already"]
        merged = on_first_rank(self._comm, lambda: is_merged(self._folder, blocks))
        if not merged:
            self._compute(most=1 if self._share == 0 else 0)
        done, seconds = self._comm.bcast((self._computed, self._busy))
        if done:
            left, teams = len(blocks) - self._begun - 1, self._shares
            path = next(block.path for block in blocks if block.path.exists())
            size = path.stat().st_size / done * len(study)
            lines += [
                f"one block of {done} cases took {duration(seconds)}; it stays in {path.parent}",
                f"the other {counted(left, 'block')} on {counted(self._comm.size, 'rank')}: about "
                f"{duration(float(f'{seconds * -(-left // teams):.2g}'))}, "
                f"{1e-6 * peak_memory():.0f} MB of memory a rank, {1.4e-6 * size:.3g} MB on disk",
            ]
        return "\n".join(lines)


def _prepare(folder: Path, blocks: Sequence[Block], retry: bool) -> None:
    """Make the folder, or look that it is of this study; remove what is to be computed again."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; must be a folder, or a new name")
    refuse_others(folder, "sweep")
    mine, others = {block.path for block in blocks}, [*(folder / FOLDER).glob("*.h5")]
    if (folder / RESULTS).exists():
        others = [folder / RESULTS]
        if is_merged(folder, blocks):
            mine.add(folder / RESULTS)
    if others and not mine & set(others):
        must = "; must be removed, or a new folder"
        with reading(others[0], SOFTWARE, FILE_KIND, must) as file:
            version = str(file.attrs["version"])
        same = version == __version__
        whose = "another study" if same else f"version {version} of ringwear-par"
        raise InputError(f"{folder}: holds cases of {whose}; must be a new folder")
    if retry:
        for path in filter(has_failed, [block.path for block in blocks]):
            path.unlink()
            (folder / RESULTS).unlink(missing_ok=True)
    if is_merged(folder, blocks):
        return
    try:
        (folder / FOLDER).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(folder, error) from error
    check_writable(folder / RESULTS)


def is_merged(folder: Path, blocks: Sequence[Block]) -> bool:
    """Tell whether the results of these blocks are in a folder. On one rank."""
    try:
        with reading(folder / RESULTS, SOFTWARE, FILE_KIND) as file:
            return bool(file.attrs.get("blocks") == fingerprint(blocks))
    except InputError:
        return False
