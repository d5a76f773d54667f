"""``ringwear run``: a case from its file to its result file, gone on with where it was stopped."""

import logging
import shlex
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np
from mpi4py import MPI

from ringwear_par.cases.case import Case
from ringwear_par.cases.plausible import implausible_numbers
from ringwear_par.errors import ComputationError, InputError, RingwearError, UnfitError, counted
from ringwear_par.files.writing import announce_replacement
from ringwear_par.history.loop import is_at_end, simulate_one
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.parallel import on_first_rank, together, warn_of_threads
from ringwear_par.results.files import restored, write_result
from ringwear_par.results.preparation import Figure, prepare
from ringwear_par.results.progress import Progress
from ringwear_par.results.recorder import Recorder
from ringwear_par.results.result import Result
from ringwear_par.results.signals import StopSignals, name_of
from ringwear_par.results.summary import labelled

log = logging.getLogger(__name__)

#: wall seconds between checkpoints
CHECKPOINT_SECONDS = 30.0


def run_case(
    path: Path,
    output: Path,
    overrides: Sequence[str] = (),
    *,
    comm: MPI.Comm,
    restart: bool = False,
    overwrite: bool = False,
    figure: Figure | None = None,
) -> None:
    """Compute a wear history, write it, and print what came of it. Collective on comm.

    Parameters
    ----------
    path : case file.
    output : result file; one of a complete or failed run is replaced.
    overrides : ``KEY=VALUE`` texts.
    restart : go on with the interrupted or shorter run that ``output`` holds.
    overwrite : replace what ``output`` holds, an interrupted run or one of another case too.
    figure : picture to be drawn at the end.

    Raises
    ------
    InputError : the case, the options or the output, before any work and with nothing written.
    ComputationError : a step failed, the run was stopped, or the result could not be written.
    """
    first = comm.rank == 0
    case, before = on_first_rank(
        comm, lambda: prepare(path, output, overrides, restart, overwrite, figure, comm.size)
    )
    if before is not None and is_at_end(case, restored(before)):
        if first:
            limit = before.attributes.get("stopped_by")
            early = f" since it reached {limit}, which may grow" if limit else ""
            log.info("%s is complete%s: nothing to compute", output, early)
        return _draw(output, figure, comm)
    if first:
        warn_of_threads(comm.size)
    recorder = Recorder([case], comm, before)
    if (start := recorder.start) is not None and first:
        steps, reached = start.progress.steps[0], start.state.time[0]
        log.info("continuing %s after step %d (%g s)", output, steps, reached)
    run = Run(case, output, recorder, comm)
    with ExitStack() as handlers:

        def begin(snapshot: Snapshot) -> bool:
            """Stop after a step, not at once, as soon as there is a state: an observer."""
            if not run.signals.noted:
                if before is None and not overwrite and first:
                    announce_replacement(output)
                handlers.enter_context(run.signals)
            return False

        _step(run, path, [recorder, begin, run])
        result = run.save_at_end()
        if first:
            print("\n".join(_lines(result, output, recorder)))
        last = recorder.last
        with together(comm):
            if last is not None and not recorder.finished:
                steps, reached = int(last.progress.steps[0]), float(last.state.time[0])
                how_far = f"(at {reached:g} of {case.time.end:g} s)"
                raise ComputationError(
                    f"stopped by {name_of(run.agreed)} after step {steps} "
                    f"{how_far if case.time.adaptive else f'of {case.time.steps}'}; {output} holds "
                    "them, and the same command with --restart continues"
                )
    return _draw(output, figure, comm)


class Run:
    """A history under way and its file: an observer in which ranks meet after every step.

    They write a checkpoint where one is due, and stop where one of them has received a signal.
    Calls are collective on comm, and answered alike on all ranks.
    """

    def __init__(self, case: Case, output: Path, recorder: Recorder, comm: MPI.Comm) -> None:
        self.case, self.output, self.recorder, self.comm = case, output, recorder, comm
        self.signals = StopSignals()
        #: the signal that the ranks agreed to stop for, or 0
        self.agreed = 0
        start = recorder.start
        #: steps that the file holds, None for none
        self._steps = None if start is None else int(start.progress.steps[0])
        #: when the last checkpoint was tried, and whether it was written
        self._saved, self._written = time.perf_counter(), True

    def __call__(self, snapshot: Snapshot) -> bool:
        """Return whether to stop after this state. Collective."""
        if snapshot.passing or snapshot.step is None:
            return False
        due = self.comm.rank == 0 and time.perf_counter() - self._saved > CHECKPOINT_SECONDS
        request = np.array([self.signals.received, due], dtype=np.int64)
        self.comm.Allreduce(MPI.IN_PLACE, request, MPI.MAX)
        self.agreed = int(request[0])
        if request[1] and not self.agreed and not snapshot.finished.all():
            try:
                self.save()
                self._written = True
            except ComputationError as error:
                if self._written and self.comm.rank == 0:
                    log.warning("checkpoint not written, going on: %s", error)
                self._written = False
            self._saved = time.perf_counter()
        return self.agreed != 0

    def save(self, error: str = "") -> Result:
        """Write the history so far. Collective."""
        begun = time.perf_counter()
        result = self.recorder.result(error)
        on_first_rank(self.comm, lambda: write_result(self.output, result))
        self.recorder.seconds_output += time.perf_counter() - begun
        last = self.recorder.last
        self._steps = None if last is None else int(last.progress.steps[0])
        return result

    def save_at_end(self, error: str = "") -> Result:
        """Write the history; where that fails, say which of its steps are stored. Collective."""
        try:
            return self.save(error)
        except ComputationError as failure:
            stored = (
                "nothing of this run is stored"
                if self._steps is None
                else f"it holds the steps up to {self._steps}, and --restart goes on from there"
            )
            before = f"{error}; and " if error else ""
            raise ComputationError(f"{before}{failure}; {stored}") from failure


def _step(run: Run, path: Path, observers: list[Callable[[Snapshot], bool]]) -> None:
    """Step a history to its end, or until an observer stops it. Collective.

    Where a step fails, the steps before it are in the file.
    """
    case, recorder, comm, end = run.case, run.recorder, run.comm, run.case.time.end
    with ExitStack() as resources:
        if comm.rank == 0:
            since = 0.0 if recorder.start is None else float(recorder.start.state.time[0])
            progress = resources.enter_context(closing(Progress(end, since)))

            def show(snapshot: Snapshot) -> bool:
                reached = float(snapshot.state.time[0])
                progress.show(
                    reached, "step %d, time %.6g of %.6g s, approach %.6f mm",
                    snapshot.progress.steps[0], reached, end, snapshot.state.contact.approach[0],
                )  # fmt: skip
                return False

            observers.append(show)
        try:
            simulate_one(case, comm, start=recorder.start, observers=observers)
        except RingwearError as error:
            for warning in implausible_numbers(case) if comm.rank == 0 else ():
                if f"{warning.keys[0]} = " not in str(error):
                    log.warning("%s: %s", path, warning.text)
            if isinstance(error, UnfitError):
                raise InputError(*(f"{path}: {fault}" for fault in error.faults)) from error
            if isinstance(error, InputError) or recorder.last is None or not recorder.last.step:
                raise
            run.save_at_end(str(error))
            raise ComputationError(
                f"{path}: {error}. {run.output} holds the steps before it: ringwear plot and "
                "report show how it came to that"
            ) from error


def _draw(output: Path, figure: Figure | None, comm: MPI.Comm) -> None:
    if figure is not None:
        on_first_rank(comm, lambda: figure.draw(output))


def _lines(result: Result, output: Path, recorder: Recorder) -> list[str]:
    """Return the lines about a run and its file, and about the command to type next."""
    file, page = (shlex.quote(str(path)) for path in (output, output.with_suffix(".html")))
    report = f"ringwear report {file} -o {page}"
    after = report if recorder.finished else "the same command with --restart"
    written = f"{output} ({counted(len(result.step), 'state')})"
    return [result.summary(), *labelled([("written", written), ("next", after)])]
