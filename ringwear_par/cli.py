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
from collections.abc import Sequence
from contextlib import suppress
from io import TextIOWrapper
from typing import Any

from ringwear_par.commands import loaded, parsed
from ringwear_par.errors import InputError, RingwearError
from ringwear_par.parallel import as_ours, on_first_rank, together
from ringwear_par.results.progress import StopSignals

#: seconds that a rank which fails, perhaps alone, leaves to the first one to say so
_LONE_SECONDS = 1.0
#: settings of Open MPI for a process without others
_ISOLATED = {
    "OMPI_MCA_ess_singleton_isolated": "1", "OMPI_MCA_pml": "ob1", "OMPI_MCA_btl": "self",
    "OMPI_MCA_mtl": "^ofi", "OMPI_MCA_io": "^romio321",
}  # fmt: skip
#: variables that launchers set: mpirun of Open MPI and MPICH, and srun
_LAUNCHED = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMI_RANK", "PMIX_RANK", "SLURM_PROCID")
#: new objects after which Python looks for those that only hold each other: a sweep makes thousands
#: of cases, and none of them does
_NEW_OBJECTS = 50_000


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status. Collective on COMM_WORLD."""
    words = list(sys.argv[1:] if argv is None else argv)
    gc.set_threshold(_NEW_OBJECTS, *gc.get_threshold()[1:])
    comm: Any = None
    try:
        with StopSignals(at_once=True):  # before anything that takes its time is imported
            comm = _world()
            _start_output(comm.rank)
            _run(words, comm)
            sys.stdout.flush()
        return 0
    except RingwearError as error:
        return _end(comm, str(error), error.exit_status, error)
    except KeyboardInterrupt as error:
        return _end(comm, f"stopped by {str(error) or 'a KeyboardInterrupt'}", 1)
    except (OSError, MemoryError) as error:
        with suppress(OSError):  # Python would try again at its end to print what is left
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            return 1
        return _end(comm, str(as_ours(error)), 1)
    except Exception as error:
        traceback.print_exc()
        return _end(comm, f"stopped by a fault of the program, a {type(error).__name__}", 1)


def _world() -> Any:
    """Return the world's communicator.

    Open MPI starts a quarter of a second sooner where it is told that no launcher started others.
    What is set for that is gone before anything else is started.
    """
    launched = any(name in os.environ for name in _LAUNCHED)
    mine = {} if launched else {n: v for n, v in _ISOLATED.items() if n not in os.environ}
    os.environ.update(mine)
    try:
        from mpi4py import MPI
    except (ImportError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise RingwearError(f"MPI for Python (mpi4py) does not load: {reason}") from error
    finally:
        for name in mine:
            del os.environ[name]
    size = MPI.COMM_WORLD.size
    wanted = os.environ.get("OMPI_COMM_WORLD_SIZE", os.environ.get("PMI_SIZE", f"{size}"))
    if wanted != f"{size}":
        raise InputError(
            f"started on {wanted} ranks but MPI has {size} rank(s): mpirun and mpi4py belong to "
            "different MPI libraries (see ringwear info)"
        )
    return MPI.COMM_WORLD


def _run(words: list[str], comm: Any) -> None:
    from ringwear_par.options import start_petsc

    cut = words.index("--") if "--" in words else len(words)
    with together(comm):
        arguments = parsed(words[:cut])
    function, kind = arguments.pop("load")
    del arguments["command"]
    if kind == "solves" or words[cut + 1 :]:
        with together(comm):
            start_petsc(words[cut + 1 :])
    if kind != "serial":
        loaded(function)(comm=comm, **arguments)
    elif text := on_first_rank(comm, lambda: loaded(function)(**arguments)):
        print(text)


def _end(comm: Any, message: str, status: int, error: BaseException | None = None) -> int:
    """Say why the command ends, and return its status.

    Where not all ranks are known to raise the error, others may be waiting: MPI ends them.
    """
    with suppress(OSError, ValueError):
        sys.stdout.flush()
    rank = os.environ.get("OMPI_COMM_WORLD_RANK", os.environ.get("PMI_RANK", "0"))
    first = rank == "0" if comm is None else comm.rank == 0
    alike = comm is None or comm.size == 1
    while error is not None and not alike:
        alike, error = getattr(error, "ranks", 0) == comm.size, error.__cause__
    if not (first or alike):
        time.sleep(_LONE_SECONDS)
    if first or not alike:
        with suppress(OSError):  # nobody reads it
            text = "\n".join(f"ringwear: {line}" for line in message.splitlines())
            print(text, file=sys.stderr, flush=True)
    if not alike:
        comm.Abort(status)
    return status


def _start_output(rank: int) -> None:
    """Let the first rank print, and all of them warn."""
    if rank > 0:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
    elif isinstance(sys.stdout, TextIOWrapper):  # any title can be printed
        sys.stdout.reconfigure(errors="backslashreplace")
    # what libraries note of their own work is not the user's
    level = logging.WARNING if rank == 0 else logging.ERROR
    logging.basicConfig(level=level, format="ringwear: %(message)s", stream=sys.stderr)
    if rank == 0:
        logging.getLogger("ringwear_par").setLevel(logging.INFO)
    # its warnings are of folders of its own that may not be written to
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
