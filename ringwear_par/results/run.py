"""From a case to its result: ``rw.simulate``, and ``ringwear run``, whose files it goes on with."""

import logging
import shlex
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from mpi4py import MPI

from ringwear_par.cases.case import SAME_TIME, Case, need_case
from ringwear_par.cases.files.keys import read_keys
from ringwear_par.cases.files.law_trials import law_sources
from ringwear_par.cases.files.reading import read_case
from ringwear_par.cases.plausible import implausible_numbers
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.errors import ComputationError, InputError, RingwearError, UnfitError, counted
from ringwear_par.files.writing import announce_replacement, check_writable
from ringwear_par.history.elastic import operator_key
from ringwear_par.history.loop import Instant, simulate_one
from ringwear_par.history.refusals import check_case
from ringwear_par.parallel import on_first_rank, together, warn_of_threads
from ringwear_par.results.files import open_result, write_result
from ringwear_par.results.key_numbers import labelled
from ringwear_par.results.progress import Progress, StopSignals, name_of
from ringwear_par.results.recorder import Recorder
from ringwear_par.results.result import Result
from ringwear_par.version import __version__

log = logging.getLogger(__name__)

#: wall seconds between checkpoints
CHECKPOINT_SECONDS = 30.0
#: endings of names of result files
_ENDINGS = (".h5", ".hdf5", ".nc")


def simulate(
    case: Case,
    comm: MPI.Comm | None = None,
    *,
    pair: ContactPair | None = None,
) -> Result:
    """Return the wear history of a case.

    Collective on comm, the world's where none is given; the same on all ranks.

    Parameters
    ----------
    case : the case, see ``read_case``.
    pair : what ``assemble`` made of a case of the same shape, mesh, Poisson's ratios and grip, to
        be used again; None: it is assembled. With ``geometry = "updated"`` numbers may differ in
        the last digits between both.

    Returns
    -------
    Result : ``.histories`` over time, ``.profiles`` over time and radius, ``.doubts``.

    Raises
    ------
    InputError : no case, a law that is none, a mesh or a memory that cannot be, bodies that
        interpenetrate, a pair of another shape.
    ComputationError : a step failed; it is named with its time.

    Examples
    --------
    >>> import ringwear_par as rw
    >>> result = rw.simulate(rw.read_case("scripts/cases/paper.toml"))
    >>> print(f"{1e3 * result.histories['penetration'][-1]:.2f} um")
    9.73 um
    """
    need_case(case, "simulate")
    comm = MPI.COMM_WORLD if comm is None else comm
    on_first_rank(comm, lambda: check_case(case, comm.size, "case"))
    if pair is not None and pair.key != operator_key(case):
        raise InputError(
            "pair: was assembled for another shape, mesh, Poisson's ratio or grip; must be "
            "assemble(case) of a case that shares them"
        )
    recorder = Recorder([case], comm, pair_is_shared=pair is not None)
    simulate_one(case, comm, recorder, pair=pair)
    return recorder.result()


def run_case(
    path: Path,
    output: Path,
    overrides: Sequence[str] = (),
    *,
    comm: MPI.Comm,
    restart: bool = False,
    overwrite: bool = False,
    figure: Any = None,
) -> None:
    """Compute a wear history, write it, and print what came of it. Collective on comm.

    Parameters
    ----------
    path, overrides : case file, and ``KEY=VALUE`` texts.
    output : result file; one of a complete or failed run is replaced.
    restart : go on with the interrupted or shorter run that ``output`` holds.
    overwrite : replace what ``output`` holds, an interrupted run or one of another case too.
    figure : picture to be drawn at the end, see ``pictures.figures.FigureFile``.

    Raises
    ------
    InputError : the case, the options or the output, before any work and with nothing written.
    ComputationError : a step failed, the run was stopped, or the result could not be written.
    """

    def checked() -> tuple[Case, Result | None]:
        case = read_case(path, overrides)
        check_case(case, comm.size, str(path))
        if figure is not None:
            figure.check(case.output)
        return case, _interrupted(path, output, case, restart, overwrite)

    case, before = on_first_rank(comm, checked)
    if before is not None and _is_at_end(case, before):
        limit = before.attributes.get("stopped_by")
        early = f" since it reached {limit}, which may grow" if limit else ""
        if comm.rank == 0:
            log.info("%s is complete%s: nothing to compute", output, early)
    else:
        if comm.rank == 0:
            warn_of_threads(comm.size)
            if before is None and not overwrite:
                announce_replacement(output)
        Run(case, path, output, before, comm).compute()
    if figure is not None:
        on_first_rank(comm, lambda: figure.draw(output))


# -- what a run goes on with -----------------------------------------------------------------------


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
    if restart:
        if fault := _difference(before, case):
            raise InputError(f"{output}: {fault}")
        return before
    if before.attributes["status"] != "complete" and not before.attributes["error"]:
        raise InputError(
            f"{output}: holds a run that was interrupted after step {before.step[-1]}; --restart "
            "continues it, --overwrite starts anew"
        )
    return None


def _difference(before: Result, case: Case) -> str:
    """Return why a stored run cannot go on to the end of a case, "" if it can.

    Keys are compared as they are written, since to read a stored case is to run the laws in it.
    """
    reached, version = float(before.last_state.time[0]), before.attributes["version"]
    growing = "time.end" if case.time.adaptive else "time.steps"
    for other, differs in (
        (f"version {version}, this is {__version__}", version != __version__),
        ("another wear law in a Python file", before.user_laws != law_sources(case)),
        ("another case", _keys(before.case) != _keys(case.stored_text)),
    ):
        if differs:
            return (
                f"is of {other}; --restart needs the same, only {growing} and limits in [stop] "
                "may change"
            )
    if reached > case.time.end * (1.0 + SAME_TIME):
        return (
            f"holds {reached:g} s, and the case ends at {case.time.end:g} s: must be at least as "
            "long with --restart"
        )
    return ""


def _is_at_end(case: Case, before: Result) -> bool:
    """Tell whether a stored history has come to the end of a case, or to the same limits."""
    same = _keys(before.case, limits=True) == _keys(case.stored_text, limits=True)
    reached = before.last_state.time[0] >= case.time.end
    return bool(reached) or ("stopped_by" in before.attributes and same)


def _keys(text: str, *, limits: bool = False) -> dict[str, Any]:
    """Return the keys of a case that must be the same where a run goes on, or its limits."""
    free = ("title", "time.end", "time.steps")
    keys = read_keys(text).items()
    return {k: v for k, v in keys if k not in free and k.startswith("stop.") == limits}


# -- a history under way ---------------------------------------------------------------------------


class Run:
    """A history under way and its file.

    Ranks meet after every step: they write a checkpoint where one is due, and stop where one of
    them has received a signal: from the first state on after a step, before it at once. Calls are
    collective on comm, and answered alike on all ranks.

    Parameters
    ----------
    path : of the case, as messages have it.
    before : result of the interrupted history that continues; None: it starts.
    """

    def __init__(
        self, case: Case, path: Path, output: Path, before: Result | None, comm: MPI.Comm
    ) -> None:
        self._case, self._path, self._output, self._comm = case, path, output, comm
        self._recorder, self._signals = Recorder([case], comm, before), StopSignals()
        self._start = None if before is None else before.last_state
        begun = 0.0 if self._start is None else float(self._start.time[0])
        self._progress = Progress(case.time.end, begun, silent=comm.rank > 0)
        #: the signal that the ranks agreed to stop for, or 0
        self._agreed = 0
        #: when the last checkpoint was tried, and whether it was written
        self._saved, self._written = time.perf_counter(), True

    def compute(self) -> None:
        """Step to the end or to a signal, write it, and print what came of it. Collective."""
        output, start, first = self._output, self._start, self._comm.rank == 0
        if start is not None and first:
            log.info("continuing %s after step %d (%g s)", output, start.steps[0], start.time[0])
        with ExitStack() as cleanup:
            cleanup.push(self._signals)  # which take over with the first state
            try:
                with closing(self._progress):
                    simulate_one(self._case, self._comm, self, first=start, every=True)
            except RingwearError as error:
                self._fail(error)
            result = self._save()
            is_complete = result.attributes["status"] == "complete"
            if first:
                file, page = (shlex.quote(str(p)) for p in (output, output.with_suffix(".html")))
                report = f"ringwear report {file} -o {page}"
                after = report if is_complete else "the same command with --restart"
                written = f"{output} ({counted(len(result.step), 'state')})"
                lines = labelled([("written", written), ("next", after)])
                print(result.summary(), *lines, sep="\n")
            with together(self._comm):
                if not is_complete:
                    raise ComputationError(
                        f"stopped by {name_of(self._agreed)} after step {result.step[-1]} (at "
                        f"{result.data['time'][-1]:g} of {self._case.time.end:g} s); {output} "
                        "holds the steps so far, and the same command with --restart continues"
                    )

    def __call__(self, instant: Instant) -> bool:
        """Take a new state; return whether to stop after it. Collective."""
        if self._recorder.last is None:
            self._signals.__enter__()
        self._recorder(instant)
        state = instant.state
        self._progress.show(
            float(state.time[0]), "step %d, time %.6g of %.6g s, approach %.6f mm",
            state.steps[0], state.time[0], self._case.time.end, state.approach[0],
        )  # fmt: skip
        if not state.steps[0]:
            return False
        due = self._comm.rank == 0 and time.perf_counter() - self._saved > CHECKPOINT_SECONDS
        request = np.array([self._signals.received, due], dtype=np.int64)
        self._comm.Allreduce(MPI.IN_PLACE, request, MPI.MAX)
        self._agreed = int(request[0])
        if request[1] and not self._agreed and not instant.ended.all():
            try:
                self._save()
                self._written = True
            except ComputationError as error:
                if self._written and self._comm.rank == 0:
                    log.warning("checkpoint not written, going on: %s", error)
                self._written = False
            self._saved = time.perf_counter()
        return self._agreed != 0

    def _save(self, error: str = "") -> Result:
        """Write the history so far. Collective."""
        begun = time.perf_counter()
        result = self._recorder.result(error)
        on_first_rank(self._comm, lambda: write_result(self._output, result))
        self._recorder.seconds_output += time.perf_counter() - begun
        return result

    def _fail(self, error: RingwearError) -> NoReturn:
        """Write the steps before one that failed, if there are any; raise its error. Collective."""
        path, last = self._path, self._recorder.last
        for warning in implausible_numbers(self._case) if self._comm.rank == 0 else ():
            if f"{warning.keys[0]} = " not in str(error):
                log.warning("%s: %s", path, warning.text)
        if isinstance(error, UnfitError):
            raise InputError(*(f"{path}: {fault}" for fault in error.faults)) from error
        if isinstance(error, InputError):
            raise error
        if last is None or not last.state.steps[0]:
            raise ComputationError(f"{path}: {error}") from error
        self._save(str(error))
        raise ComputationError(
            f"{path}: {error}. {self._output} holds the steps before it: ringwear plot and report "
            "show how it came to that"
        ) from error
