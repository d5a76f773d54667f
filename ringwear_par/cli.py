"""The ``ringwear`` command: how it starts and ends, alike on one rank and on many.

It works on the world's communicator, and starts PETSc with the arguments behind ``--`` before any
other module imports it.
"""

import gc
import logging
import os
import sys
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from io import TextIOWrapper
from typing import Any

from ringwear_par.commands import COMMANDS, UNWRITTEN, check_command, overview, parsed
from ringwear_par.errors import LONGEST_SENTENCE, InputError, RingwearError, legible
from ringwear_par.results.execution.stop_signals import (
    StopAtOnce,
    Stopped,
    ignore_at_end,
    is_launched,
    remark,
)

#: how long a rank that fails waits for the others to fail alike, and one that is stopped: mpirun
#: kills a second after its signal
GRACE_SECONDS = 10.0
STOP_SECONDS = 0.5
#: settings of Open MPI for a process without others
_ISOLATED = {
    "OMPI_MCA_ess_singleton_isolated": "1",
    "OMPI_MCA_pml": "ob1",
    "OMPI_MCA_btl": "self",
    "OMPI_MCA_mtl": "^ofi",
    "OMPI_MCA_io": "^romio321",
}
#: new objects after which Python looks for those that only hold each other: a sweep makes thousands
#: of cases, and none of them does
_NEW_OBJECTS = 50_000
#: message between ranks: why the command ends is said
_REPORTED = 1


def _check_launch(size: int) -> None:
    for name in ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE"):
        launched = os.environ.get(name)
        if launched is not None and launched.isdecimal() and int(launched) != size:
            raise InputError(
                f"{name} = {launched} but MPI has {size} rank(s): mpirun and mpi4py belong to "
                "different MPI libraries (see ringwear info)"
            )


class _World:
    """The ranks of the command: nothing is known of them before MPI is there."""

    def __init__(self) -> None:
        self.comm: Any = None
        #: a communicator of their own, to fail together
        self.together: Any = None
        self._reported = False
        self._notices: list[Any] = []  # on their way, which must not be freed

    @property
    def first(self) -> bool:
        """Whether this rank speaks for all."""
        if self.comm is not None:
            return bool(self.comm.rank == 0)
        names = ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK")
        return all(os.environ.get(name, "0") == "0" for name in names)

    def others_come(self, patience: float) -> bool:
        """Wait a little for the other ranks to fail, too; they may be waiting in a collective."""
        if self.together is None:
            return True
        request, started = self.together.Ibarrier(), time.monotonic()
        while not request.Test():
            if time.monotonic() - started > patience:
                return False
            time.sleep(0.001)
        return True

    def end(self, message: str, status: int, patience: float) -> int:
        """Say once why the command ends, and return its status; end ranks that still wait."""
        if self.first:  # at once: launchers end the others as soon as one has ended
            self._say(message)
        if not self.others_come(patience):
            self._say(message)
            self.comm.Abort(status)
        return status

    def _say(self, message: str) -> None:
        """Say it once: what ends a command on one rank has the launcher stop the others, too."""
        if not self._reported and not self._reported_elsewhere():
            self._reported = True
            if self.together is not None:
                self._notices = [
                    self.together.isend(None, rank, _REPORTED)
                    for rank in range(self.comm.size)
                    if rank != self.comm.rank
                ]
            with suppress(OSError):  # nobody can be told
                lines = "\n".join(f"ringwear: {line}" for line in message.splitlines())
                print(lines, file=sys.stderr, flush=True)

    def _reported_elsewhere(self) -> bool:
        """Tell whether another rank has said why the command ends."""
        if self.together is None:
            return False
        from mpi4py import MPI

        return bool(self.together.Iprobe(MPI.ANY_SOURCE, _REPORTED))


def _place(error: BaseException) -> str:
    """Return the file and line that raised an error."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{last.filename}, line {last.lineno}"


def _output_fault() -> str:
    """Return why standard output takes nothing, "" if it does."""
    try:
        print(flush=True)
    except OSError as error:
        return error.strerror or str(error)
    return ""


def _mute() -> None:
    """Drop what standard output does not take, which Python would try again at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status. Collective on COMM_WORLD."""
    words = list(sys.argv[1:] if argv is None else argv)
    world, status = _World(), None
    try:
        with StopAtOnce() as signals:  # before anything that takes its time is imported
            status = _main(words, world, signals)
    except Stopped as stopped:
        if status is None:  # else it came too late
            return world.end(
                f"stopped by {stopped}{_left(words)}{remark(stopped.number)}", 1, STOP_SECONDS
            )
    finally:
        ignore_at_end()
    return status


def _left(words: Sequence[str]) -> str:
    """Return the words about files of a command that was stopped before it had results."""
    if "--dry-run" in words:
        return UNWRITTEN
    command = COMMANDS.get(words[0]) if words else None
    return "" if command is None else command.stopped


@contextmanager
def _without_other_processes() -> Iterator[None]:
    """Have Open MPI start without looking for other processes, where no launcher started this one.

    That takes a quarter of a second less. What is set here is gone before anything else is started.
    """
    settings = {} if is_launched() else _ISOLATED
    mine = {name: value for name, value in settings.items() if name not in os.environ}
    os.environ.update(mine)
    try:
        yield
    finally:
        for name in mine:
            del os.environ[name]


def _main(words: Sequence[str], world: _World, signals: StopAtOnce) -> int:
    gc.set_threshold(_NEW_OBJECTS, *gc.get_threshold()[1:])
    cut = words.index("--") if "--" in words else len(words)

    try:
        with _without_other_processes():
            from mpi4py import MPI
    except (ImportError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        print(f"ringwear: MPI for Python (mpi4py) does not load: {reason}", file=sys.stderr)
        return 1

    from ringwear_par.options import start_petsc
    from ringwear_par.parallel import as_ours, claim_blas_memory, is_shortage, on_first_rank

    world.comm = comm = MPI.COMM_WORLD
    world.together = comm.Dup() if comm.size > 1 else None
    _start_logging(comm.rank)
    if comm.rank > 0:  # --help and --version are for one rank to print
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
    elif isinstance(sys.stdout, TextIOWrapper):  # any title can be printed
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        if not words:
            print(overview())
            return 0
        check_command(words[0])
        arguments = parsed(words[:cut])
        name = arguments.pop("command")
        command = COMMANDS[name]
        _check_launch(comm.size)
        if arguments.pop("no_cache", name == "verify"):
            from ringwear_par.elasticity import pair_cache

            os.environ[pair_cache.VARIABLE] = ""
        if command.solves or words[cut + 1 :]:
            start_petsc(words[cut + 1 :])
        if command.solves:
            claim_blas_memory(comm)
        if command.serial:
            text = on_first_rank(comm, lambda: command.load()(**arguments))
            if text:
                print(text)
        else:
            command.load()(comm=comm, **arguments)
        sys.stdout.flush()
        return 0
    except RingwearError as error:
        signals.check()  # which may be what has made something fail
        return world.end(str(error), error.exit_status, GRACE_SECONDS)
    except BrokenPipeError:
        _mute()
        return 1
    except KeyboardInterrupt as error:  # of a user's law: signals are noted, or raise Stopped
        return world.end(f"stopped by a KeyboardInterrupt of {_place(error)}", 1, GRACE_SECONDS)
    except Exception as error:
        signals.check()
        if is_shortage(error):
            # what the frames hold that it came through is needed to say so
            sentence = str(as_ours(error))
            traceback.clear_frames(error.__traceback__)
            return world.end(sentence, 1, GRACE_SECONDS)
        output_fault = _output_fault() if isinstance(error, OSError) else ""
        if output_fault:
            with suppress(OSError):
                print(f"ringwear: standard output: {output_fault}", file=sys.stderr, flush=True)
            _mute()
        else:
            traceback.print_exc()
        sys.stderr.flush()
        if comm.size > 1:  # the other ranks would wait for this one for ever
            comm.Abort(1)
        return 1


class _OneLine(logging.Formatter):
    """Messages on one line, with what would not be seen escaped."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802
        return legible(super().formatMessage(record), LONGEST_SENTENCE)


def _start_logging(rank: int) -> None:
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_OneLine("ringwear: %(message)s"))
    # what libraries note of their own work is not the user's
    logging.basicConfig(level=logging.WARNING if rank == 0 else logging.ERROR, handlers=[handler])
    if rank == 0:
        logging.getLogger("ringwear_par").setLevel(logging.INFO)
    # its warnings are of folders of its own that may not be written to
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
