"""``ringwear run``: a case from its file to its result file, gone on with where it was stopped."""

import logging
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path

from mpi4py import MPI

from ringwear_par import __version__
from ringwear_par.atomic import check_writable
from ringwear_par.cases.case import Case
from ringwear_par.cases.files.keys import named_files, read_keys
from ringwear_par.cases.files.law_trials import law_files, law_sources
from ringwear_par.cases.files.reading import parse_case, read_case
from ringwear_par.errors import ComputationError, InputError, RingwearError, UnfitError
from ringwear_par.history.limits import check_case
from ringwear_par.history.loop import simulate_one
from ringwear_par.history.snapshots import Observer, Snapshot
from ringwear_par.options import reject_unused_options
from ringwear_par.parallel import on_first_rank, warn_of_threads
from ringwear_par.results.execution.progress import Progress
from ringwear_par.results.execution.recorder import Recorder
from ringwear_par.results.execution.watch import Watch
from ringwear_par.results.result import Result
from ringwear_par.results.storage.checkpoints import restored
from ringwear_par.results.storage.result_files import (
    open_result,
    read_error,
    read_status,
    write_result,
)
from ringwear_par.results.unit_suspicions import unit_suspicions
from ringwear_par.stopping import StopSignals, remark

log = logging.getLogger(__name__)


def run_case(
    path: Path,
    output: Path,
    overrides: Sequence[str] = (),
    *,
    comm: MPI.Comm,
    restart: bool = False,
    overwrite: bool = False,
    figure: Path | None = None,
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
    started = time.perf_counter()
    case, before = on_first_rank(
        comm, lambda: _prepare(path, output, overrides, restart, overwrite, figure, comm.size)
    )
    if before is not None and _reached(case, before):
        if comm.rank == 0:
            log.info("%s is complete: nothing to compute", output)
        return _draw(output, figure, comm)
    if comm.rank == 0:
        warn_of_threads(comm.size)
    recorder = Recorder([case], comm, before)
    if recorder.start is not None and comm.rank == 0:
        reached = recorder.start
        log.info(
            "continuing %s after step %d (%g s)", output, reached.progress.steps[0],
            reached.state.time[0],
        )  # fmt: skip
        version = before.attributes["version"] if before is not None else __version__
        if version != __version__:
            log.warning(
                "%s was computed so far by version %s, this is %s: it keeps both in one history "
                "(attribute begun_by)", output, version, __version__,
            )  # fmt: skip

    stored = None if recorder.start is None else int(recorder.start.progress.steps[0])

    def save(error: str = "") -> Result:
        """Write what there is so far. Collective."""
        nonlocal stored
        begun = time.perf_counter()
        result = recorder.result(error)
        on_first_rank(comm, lambda: write_result(output, result))
        recorder.seconds_output += time.perf_counter() - begun
        stored = None if recorder.last is None else int(recorder.last.progress.steps[0])
        return result

    def save_at_end(error: str = "") -> Result:
        """Write what there is; where that fails, say what there is then. Collective."""
        try:
            return save(error)
        except ComputationError as failure:
            stored_steps = (
                "nothing of this run is stored"
                if stored is None
                else f"it holds the steps up to {stored}, and --restart goes on from there"
            )
            before = f"{error}; and " if error else ""
            raise ComputationError(f"{before}{failure}; {stored_steps}") from failure

    signals = StopSignals()
    with ExitStack() as noting:

        def note_signals(snapshot: Snapshot) -> bool:
            """Stop after a step, not at once, as soon as there is a state: an observer."""
            if not signals.noted:
                noting.enter_context(signals)
            return False

        with ExitStack() as at_end:
            watch = Watch(signals, save, comm)
            observers: list[Observer] = [recorder, note_signals, _check_options, watch]
            if comm.rank == 0:
                since = 0.0 if recorder.start is None else float(recorder.start.state.time[0])
                observers.append(at_end.enter_context(closing(Progress(since, case.time.end))))
            try:
                with _doubting(case, path, comm):
                    simulate_one(case, comm, start=recorder.start, observers=observers)
            except UnfitError as error:
                raise InputError(*(f"{path}: {fault}" for fault in error.faults)) from error
            except InputError:
                raise
            except RingwearError as error:
                if recorder.last is None or recorder.last.step is None:
                    raise
                save_at_end(str(error))
                raise ComputationError(
                    f"{error} of {path}; {output} holds the steps before it, and ringwear plot or "
                    "report show how it came to that"
                ) from error
            result = save_at_end()
        if comm.rank == 0:
            print(result.summary())
            start_up = max(seconds_since_start() - (time.perf_counter() - started), 0.0)
            print(_times(recorder.seconds(), start_up, recorder.kernel_evaluations()))
        last = recorder.last
        if last is not None and not recorder.finished:
            raise ComputationError(
                f"stopped by {watch.signal_name} after step {last.progress.steps[0]} "
                f"{_progress(case, float(last.state.time[0]))}; {output} holds them, and the same "
                f"command with --restart continues{remark(watch.agreed)}"
            )
    return _draw(output, figure, comm)


@contextmanager
def _doubting(case: Case, path: Path, comm: MPI.Comm) -> Iterator[None]:
    """Log the suspicious units of a case that fails, but for those that its error names."""
    try:
        yield
    except RingwearError as error:
        if comm.rank == 0:
            for warning in unit_suspicions(case):
                if not warning.key or f"{warning.key} = " not in str(error):
                    log.warning("%s: %s", path, warning.text)
        raise


def _check_options(snapshot: Snapshot) -> bool:
    """Refuse unused PETSc options once the first contact is solved: an observer."""
    if snapshot.step is None:
        reject_unused_options()
    return False


def _reached(case: Case, result: Result) -> bool:
    """Tell whether a result has come to the end of a case."""
    start = restored(result)
    return case.time.finished(int(start.progress.steps[0]), float(start.state.time[0]))


def _progress(case: Case, time: float) -> str:
    """Return how far a history is."""
    if case.time.adaptive:
        return f"(at {time:g} of {case.time.end:g} s)"
    return f"of {case.time.steps}"


def _draw(output: Path, figure: Path | None, comm: MPI.Comm) -> None:
    if figure is not None:
        from ringwear_par.results.pictures.figures import plot_files

        on_first_rank(comm, lambda: plot_files([output], figure))


def _times(seconds: dict[str, float], start_up: float, evaluations: int) -> str:
    names = ("assembly", "factorisation", "stepping", "output")
    parts = ", ".join(f"{name} {seconds[f'seconds_{name}']:.3f}" for name in names)
    counted = f"{evaluations} kernel evaluations" if evaluations else "of a shape that was known"
    return f"seconds: start-up {start_up:.2f}, {parts} ({counted})"


def seconds_since_start() -> float:
    """Return the age of this process, s; 0 where the system does not tell. Not collective."""
    try:
        started = float(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
        uptime = float(Path("/proc/uptime").read_text().split()[0])
    except (OSError, IndexError, ValueError):
        return 0.0
    return uptime - started / os.sysconf("SC_CLK_TCK")


def _prepare(
    path: Path,
    output: Path,
    overrides: Sequence[str],
    restart: bool,
    overwrite: bool,
    figure: Path | None,
    ranks: int,
) -> tuple[Case, Result | None]:
    """Read and check all that a run needs, before any work. On one rank."""
    faults: list[str] = []
    case = before = None
    try:
        case = read_case(path, overrides)
        check_case(case, ranks, str(path))
    except InputError as error:
        faults += error.faults
    if restart and overwrite:
        faults.append("--restart, --overwrite: must be one of them, to go on or to start anew")
    try:
        check_writable(output)
        if output.exists() and path.exists() and output.samefile(path):
            raise InputError(f"{output}: is the case file itself; must be another name")
        if case is not None and not overwrite:
            before = _what_is_there(output, case, restart)
    except InputError as error:
        faults += error.faults
    if figure is not None:
        from ringwear_par.results.pictures.figures import check_figure

        try:
            check_figure(figure, case.output if case is not None else None)
        except InputError as error:
            faults += error.faults
    if faults or case is None:
        raise InputError(*faults)
    return case, before


def _what_is_there(output: Path, case: Case, restart: bool) -> Result | None:
    """Return the result to go on with; refuse to lose one that was interrupted.

    A run that is complete, or that failed, is replaced without a question.

    Raises
    ------
    InputError : the reason.
    """
    present = read_status(output)
    if present is None:
        return None
    status, steps = present
    if not restart and (status == "complete" or read_error(output)):
        return None
    before = open_result(output)
    fault = _difference(before, case)
    if restart and not fault:
        return before
    if restart:
        raise InputError(f"{output}: {fault}")
    raise InputError(
        f"{output}: holds a run that was interrupted after step {steps}; "
        + (
            "it is one of another case, and --overwrite replaces it"
            if fault
            else "--restart continues it, --overwrite starts anew"
        )
    )


def _difference(before: Result, case: Case) -> str:
    """Return why a stored run cannot go on to the end of a case, "" if it can."""
    if before.user_laws != law_sources(case):
        return (
            "was computed with another wear law in a Python file than there is now; --restart "
            "needs the same"
        )
    if before.derivatives:
        return (
            "holds derivatives, which a run does not go on with; must be a result without, or "
            "another name"
        )
    growing = "time.end" if case.time.adaptive else "time.steps"
    other = f"holds another case; --restart needs the same case, only {growing} may grow"
    # to read a case is to run the laws that it names: of a stored one only what this one runs too
    if named_files(read_keys(before.case, str(before.path))) != law_files(case):
        return other
    stored = parse_case(before.case, str(before.path))
    same = replace(stored, time=case.time, title=case.title, text=case.text)
    longer = replace(stored.time, steps=case.time.steps, until=case.time.until)
    if same != case or longer != case.time:
        return other
    reached = restored(before)
    time, steps = float(reached.state.time[0]), int(reached.progress.steps[0])
    if case.time.adaptive and time > case.time.end:
        return (
            f"holds {time:g} s, time.end = {case.time.end:g}: must be at least "
            "as long with --restart"
        )
    if not case.time.adaptive and steps > case.time.steps:
        return (
            f"holds {steps} steps, time.steps = {case.time.steps}: must be at "
            "least as many with --restart"
        )
    return ""
