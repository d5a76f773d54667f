"""``ringwear run``: a case from its file to its result file, gone on with where it was stopped."""

import logging
import shlex
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing, nullcontext
from pathlib import Path
from typing import Any, NoReturn, Protocol

import numpy as np
from mpi4py import MPI

from ringwear_par.cases.case import SAME_TIME, Case, Output
from ringwear_par.cases.files.keys import read_keys
from ringwear_par.cases.files.law_trials import law_sources
from ringwear_par.cases.files.reading import read_case
from ringwear_par.cases.plausible import implausible_numbers
from ringwear_par.errors import ComputationError, InputError, RingwearError, UnfitError, counted
from ringwear_par.files.writing import announce_replacement, check_writable
from ringwear_par.history.loop import Instant, simulate_one
from ringwear_par.history.refusals import check_case
from ringwear_par.parallel import on_first_rank, together, warn_of_threads
from ringwear_par.results.files import open_result, write_result
from ringwear_par.results.progress import Progress
from ringwear_par.results.recorder import Recorder
from ringwear_par.results.result import Result
from ringwear_par.results.signals import StopSignals, name_of
from ringwear_par.results.summary import labelled
from ringwear_par.version import __version__

log = logging.getLogger(__name__)

#: wall seconds between checkpoints
CHECKPOINT_SECONDS = 30.0
#: endings of names of result files
_ENDINGS = (".h5", ".hdf5", ".nc")


class Figure(Protocol):
    """A picture that is drawn of a result file."""

    def check(self, stored: Output | None) -> None:
        """Refuse a picture that cannot be written, or drawn from what a case stores."""

    def draw(self, results: Path) -> None:
        """Draw and write it."""


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
        comm, lambda: _checked(path, output, overrides, restart, overwrite, figure, comm.size)
    )
    if before is None or not _is_at_end(case, before):
        if first:
            warn_of_threads(comm.size)
            if before is None and not overwrite:
                announce_replacement(output)
        _compute(Run(case, output, before, comm), path)
    elif first:
        limit = before.attributes.get("stopped_by")
        early = f" since it reached {limit}, which may grow" if limit else ""
        log.info("%s is complete%s: nothing to compute", output, early)
    if figure is not None:
        on_first_rank(comm, lambda: figure.draw(output))


# -- before any work -------------------------------------------------------------------------------


def _checked(
    path: Path,
    output: Path,
    overrides: Sequence[str],
    restart: bool,
    overwrite: bool,
    figure: Figure | None,
    ranks: int,
) -> tuple[Case, Result | None]:
    """Return the case, and the result of the run that it goes on with, if any. On one rank."""
    case = read_case(path, overrides)
    check_case(case, ranks, str(path))
    if figure is not None:
        figure.check(case.output)
    return case, _interrupted(path, output, case, restart, overwrite)


def _interrupted(
    path: Path, output: Path, case: Case, restart: bool, overwrite: bool
) -> Result | None:
    """Return the result to go on with; refuse to lose one that was interrupted, or another file.

    A run that is complete, or that failed, is replaced without a question.
    """
    if restart and overwrite:
        raise InputError("--restart, --overwrite: must be one of them, to go on or to start anew")
    check_writable(output)
    if output.exists() and output.samefile(path):
        raise InputError(f"{output}: is the case file itself; must be another name")
    if output.suffix and output.suffix not in _ENDINGS:
        raise InputError(
            f"{output}: its ending must be one of {', '.join(_ENDINGS)}; ringwear export writes "
            "tables of results"
        )
    if overwrite or not output.exists():
        return None
    try:
        before = open_result(output)
    except InputError as error:
        raise InputError(
            f"{error}; must be one (--restart), another name, or be replaced by --overwrite"
        ) from error
    about = before.attributes
    if not restart and (about["status"] == "complete" or about["error"]):
        return None
    if not restart:
        raise InputError(
            f"{output}: holds a run that was interrupted after step {before.step[-1]}; --restart "
            "continues it, --overwrite starts anew"
        )
    if fault := _difference(before, case):
        raise InputError(f"{output}: {fault}")
    return before


def _difference(before: Result, case: Case) -> str:
    """Return why a stored run cannot go on to the end of a case, "" if it can.

    Keys are compared as they are written, since to read a stored case is to run the laws in it.
    """
    growing = "time.end" if case.time.adaptive else "time.steps"
    if (version := before.attributes["version"]) != __version__:
        return f"was computed by version {version}, this is {__version__}; --restart needs the same"
    if before.user_laws != law_sources(case):
        return (
            "was computed with another wear law in a Python file than there is now; --restart "
            "needs the same"
        )
    if _keys(before.case) != _keys(case.stored_text):
        return (
            f"holds another case; --restart needs the same case, only {growing} and limits in "
            "[stop] may change"
        )
    reached = float(before.last_state.time[0])
    if reached > case.time.end * (1.0 + SAME_TIME):
        return (
            f"holds {reached:g} s, and the case ends at {case.time.end:g} s: must be at least as "
            "long with --restart"
        )
    return ""


def _is_at_end(case: Case, before: Result) -> bool:
    """Tell whether a stored history has come to the end of a case, or to the same limits."""
    stopped = "stopped_by" in before.attributes
    same = _keys(before.case, limits=True) == _keys(case.stored_text, limits=True)
    return before.last_state.time[0] >= case.time.end or (stopped and same)


def _keys(text: str, *, limits: bool = False) -> dict[str, Any]:
    """Return the keys of a case that must be the same where a run goes on, or its limits."""
    free = ("title", "time.end", "time.steps")
    keys = read_keys(text).items()
    return {k: v for k, v in keys if k not in free and k.startswith("stop.") == limits}


# -- a history under way ---------------------------------------------------------------------------


class Run:
    """A history under way and its file: takes states, and lets ranks meet after every step.

    They write a checkpoint where one is due, and stop where one of them has received a signal: from
    the first state on after a step, before it at once. Calls are collective on comm, and answered
    alike on all ranks.

    Parameters
    ----------
    before : result of the interrupted history that continues; None: it starts.
    """

    def __init__(self, case: Case, output: Path, before: Result | None, comm: MPI.Comm) -> None:
        self.case, self.output, self.comm = case, output, comm
        self.recorder = Recorder([case], comm, before)
        self.signals = StopSignals()
        since = 0.0 if before is None else float(before.last_state.time[0])
        self.progress = Progress(case.time.end, since) if comm.rank == 0 else None
        #: the signal that the ranks agreed to stop for, or 0
        self.agreed = 0
        #: when the last checkpoint was tried, and whether it was written
        self._saved, self._written = time.perf_counter(), True

    def __call__(self, instant: Instant) -> bool:
        """Take a new state; return whether to stop after it. Collective."""
        if self.recorder.last is None:
            self.signals.__enter__()
        self.recorder(instant)
        state = instant.state
        if self.progress is not None:
            self.progress.show(
                float(state.time[0]), "step %d, time %.6g of %.6g s, approach %.6f mm",
                state.steps[0], state.time[0], self.case.time.end, state.approach[0],
            )  # fmt: skip
        if not state.steps[0]:
            return False
        due = self.comm.rank == 0 and time.perf_counter() - self._saved > CHECKPOINT_SECONDS
        request = np.array([self.signals.received, due], dtype=np.int64)
        self.comm.Allreduce(MPI.IN_PLACE, request, MPI.MAX)
        self.agreed = int(request[0])
        if request[1] and not self.agreed and not instant.ended.all():
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
        return result


def _compute(run: Run, path: Path) -> None:
    """Step a history to its end or to a signal, write it, and print what came of it. Collective."""
    output, recorder, first = run.output, run.recorder, run.comm.rank == 0
    if (start := recorder.first) is not None and first:
        steps, reached = start.steps[0], start.time[0]
        log.info("continuing %s after step %d (%g s)", output, steps, reached)
    with ExitStack() as cleanup:
        cleanup.push(run.signals)
        try:
            with closing(run.progress) if run.progress is not None else nullcontext():
                simulate_one(run.case, run.comm, run, first=start, every=True)
        except RingwearError as error:
            _failed(run, path, error)
        result = run.save()
        if first:
            file, page = (shlex.quote(str(p)) for p in (output, output.with_suffix(".html")))
            report = f"ringwear report {file} -o {page}"
            after = report if recorder.finished else "the same command with --restart"
            written = f"{output} ({counted(len(result.step), 'state')})"
            print(result.summary(), *labelled([("written", written), ("next", after)]), sep="\n")
        with together(run.comm):
            if not recorder.finished:
                raise ComputationError(
                    f"stopped by {name_of(run.agreed)} after step {result.step[-1]} (at "
                    f"{result.data['time'][-1]:g} of {run.case.time.end:g} s); {output} holds the "
                    "steps so far, and the same command with --restart continues"
                )


def _failed(run: Run, path: Path, error: RingwearError) -> NoReturn:
    """Write the steps before one that failed, if there are any, and raise its error. Collective."""
    for warning in implausible_numbers(run.case) if run.comm.rank == 0 else ():
        if f"{warning.keys[0]} = " not in str(error):
            log.warning("%s: %s", path, warning.text)
    if isinstance(error, UnfitError):
        raise InputError(*(f"{path}: {fault}" for fault in error.faults)) from error
    last = run.recorder.last
    if isinstance(error, InputError):
        raise error
    if last is None or not last.state.steps[0]:
        raise ComputationError(f"{path}: {error}") from error
    run.save(str(error))
    raise ComputationError(
        f"{path}: {error}. {run.output} holds the steps before it: ringwear plot and report show "
        "how it came to that"
    ) from error
