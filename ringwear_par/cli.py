"""The ``ringwear`` command: arguments, errors and exit statuses, alike on one rank and on many.

It works on the world's communicator, and starts PETSc with the arguments behind ``--`` before any
other module imports it.
"""

import argparse
import logging
import os
import re
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import TextIOWrapper
from pathlib import Path
from typing import Any, NoReturn

from ringwear_par.errors import LONGEST_SENTENCE, InputError, RingwearError, legible
from ringwear_par.results.execution.stopping import StopAtOnce, Stopped, ignore_at_end, remark
from ringwear_par.version import __version__

#: how long a rank that fails waits for the others to fail alike, and one that is stopped: mpirun
#: kills a second after its signal
GRACE_SECONDS = 10.0
STOP_SECONDS = 0.5
#: variables that launchers set: mpirun of Open MPI and MPICH, and srun
_LAUNCHED = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMI_RANK", "PMIX_RANK", "SLURM_PROCID")
#: settings of Open MPI for a process without others
_ISOLATED = {
    "OMPI_MCA_ess_singleton_isolated": "1",
    "OMPI_MCA_pml": "ob1",
    "OMPI_MCA_btl": "self",
    "OMPI_MCA_mtl": "^ofi",
    "OMPI_MCA_io": "^romio321",
}
#: message between ranks: why the command ends is said
_SAID = 1
#: what plot draws if it is not told
PANELS = "wear,penetration"

EPILOG = """\
Everything after -- goes to PETSc's options: -bem_... for the boundary element systems,
-contact_... for the contact solver (-contact_tao_type python|tron|bnls, -contact_tao_monitor).
Exit status: 0 done, 1 the computation failed or was stopped, 2 bad input.
"""


class _Parser(argparse.ArgumentParser):
    """A parser whose complaints are said once, not once per rank."""

    def error(self, message: str) -> NoReturn:
        raise InputError(
            f"{legible(message, 300)} (see {self.prog} --help; PETSc's options go behind --)"
        )


def _slice(text: str) -> tuple[int, int]:
    if not re.fullmatch(r"[0-9]{1,20}/[0-9]{1,20}", text):
        raise argparse.ArgumentTypeError(f"{legible(text)}: must be I/N, such as 2/8")
    first, _, last = text.partition("/")
    return int(first), int(last)


def _port(text: str) -> int:
    if not (re.fullmatch("[0-9]{1,5}", text) and int(text) < 65536):
        raise argparse.ArgumentTypeError(f"{legible(text)}: must be a whole number up to 65535")
    return int(text)


def _path(text: str) -> Path:
    """Return a path that there is, or may be."""
    try:
        os.stat(text)
    except (FileNotFoundError, NotADirectoryError):
        pass
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise argparse.ArgumentTypeError(f"{legible(text)}: {reason}") from error
    return Path(text)


def _run(args: argparse.Namespace, comm: Any) -> None:
    from ringwear_par.results.execution.run import run_case

    figure = None
    if args.plot is not None:
        from ringwear_par.pictures.figures import FigureFile

        figure = FigureFile(args.plot)
    run_case(
        args.case, args.output, args.overrides, comm=comm, restart=args.restart,
        overwrite=args.overwrite, figure=figure,
    )  # fmt: skip


def _sweep(args: argparse.Namespace, comm: Any) -> None:
    from ringwear_par.studies.execution.sweep import run_sweep

    run_sweep(
        args.study, args.output, comm, ranks_per_case=args.ranks_per_case, part=args.part,
        retry_failed=args.retry_failed, mix_versions=args.mix_versions, dry_run=args.dry_run,
    )  # fmt: skip


def _fit(args: argparse.Namespace, comm: Any) -> None:
    from ringwear_par.identification.fit import run_fit

    run_fit(
        args.fit, args.output, comm, dry_run=args.dry_run, restart=args.restart,
        compare=args.compare,
    )  # fmt: skip


def _design(args: argparse.Namespace, comm: Any) -> None:
    from ringwear_par.identification.test_design.design import run_design

    run_design(args.fit, args.output, comm, after=args.after, criterion=args.criterion)


def _measure(args: argparse.Namespace, comm: Any) -> None:
    from ringwear_par.measuring.measure import run_measure
    from ringwear_par.parallel import on_first_rank

    summary = on_first_rank(
        comm, lambda: run_measure(args.sources, args.output, args.case, args.masses)
    )
    if comm.rank == 0:
        print(summary)


def _plot(args: argparse.Namespace, comm: Any) -> None:
    from ringwear_par.parallel import on_first_rank

    folders = [path for path in args.results if path.is_dir()]
    if not folders:
        from ringwear_par.pictures.figures import plot_files

        chosen = args.panels or PANELS, args.steps or "", args.profiles_of or (), args.times or ""
        on_first_rank(comm, lambda: plot_files(args.results, args.output, *chosen))
        return
    from ringwear_par.files.folders import refuse_drawn
    from ringwear_par.studies.pictures.figures import plot_sweep

    refuse_drawn(folders[0])
    if len(args.results) > 1:
        raise InputError(f"{folders[0]}: is a folder; must be the only thing to be drawn")
    for name in ("panels", "steps", "profiles_of", "times"):
        if getattr(args, name) is not None:
            raise InputError(
                f"--{name.replace('_', '-')}: must be absent where {folders[0]}, a folder, is "
                "drawn; it is for result files"
            )
    on_first_rank(comm, lambda: plot_sweep(folders[0], args.output))


def _export(args: argparse.Namespace, comm: Any) -> None:
    from ringwear_par.parallel import on_first_rank
    from ringwear_par.results.storage.export import export

    chosen = args.revolve, args.scale, args.fields, args.stress, args.interfaces
    print(on_first_rank(comm, lambda: export(args.result, args.output, *chosen)))


def _report(args: argparse.Namespace, comm: Any) -> None:
    from ringwear_par.parallel import on_first_rank
    from ringwear_par.reports.report import report

    print(on_first_rank(comm, lambda: report(args.results, args.output)))


def _explore(args: argparse.Namespace, comm: Any) -> None:
    from ringwear_par.explorer.server import explore

    explore(args.case, args.overrides, comm=comm, port=args.port, browser=not args.no_browser)


def _laws(args: argparse.Namespace, comm: Any) -> None:
    from ringwear_par.cases.files.law_trials import check_laws
    from ringwear_par.parallel import on_first_rank

    on_first_rank(comm, lambda: check_laws(args.case, args.overrides))


def _verify(args: argparse.Namespace, comm: Any) -> None:
    from ringwear_par.verification.verify import verify

    verify(comm)


def _print_keys(words: Sequence[str]) -> None:
    """Print the keys of case, study, fit and measure files, or of one of these; a row a key.

    Parameters
    ----------
    words : a kind of file or none, and then what the rows contain.

    Raises
    ------
    InputError : no row contains it.
    """
    from ringwear_par.cases import schema as cases
    from ringwear_par.identification.definition import schema as fits
    from ringwear_par.measuring.definition import schema as measures
    from ringwear_par.studies.definition import schema as studies

    schemas = {"case": cases.KEYS, "study": studies.KEYS, "fit": fits.KEYS,
               "measure": measures.KEYS}  # fmt: skip
    kinds = words[:1] if words and words[0] in schemas else list(schemas)
    phrase = " ".join(words[1:] if words[:1] == kinds else words)
    tables = {kind: cases.key_table(schemas[kind], phrase) for kind in kinds}
    if not any(tables.values()):
        files = " or ".join(kinds)
        raise InputError(f"--schema {legible(phrase)}: is in no row of the keys of {files} files")
    for kind, table in tables.items():
        if len(kinds) > 1:
            print(f"Keys of {kind} files\n")
        print(table or f"  none with {phrase}", end="\n\n" if kind != kinds[-1] else "\n")


def _info(args: argparse.Namespace, comm: Any) -> None:
    if args.schema is not None:
        _print_keys(args.schema)
        return
    from ringwear_par.info import print_info

    print_info(comm)


@dataclass(frozen=True)
class _Command:
    """A command, in the order of ``ringwear --help``.

    Parameters
    ----------
    summary : for its help.
    run : takes the arguments and the communicator.
    arguments : flags and options of ``add_argument``.
    solves : whether it needs PETSc.
    stopped : end of the message where it is stopped before it has results.
    """

    summary: str
    run: Callable[[argparse.Namespace, Any], None]
    arguments: tuple[tuple[tuple[str, ...], dict[str, Any]], ...]
    solves: bool = False
    stopped: str = ""


def _argument(*flags: str, **options: Any) -> tuple[tuple[str, ...], dict[str, Any]]:
    return flags, options


def _flag(name: str, help: str) -> tuple[tuple[str, ...], dict[str, Any]]:
    return (name,), {"action": "store_true", "help": help}


def _output(metavar: str, help: str | None = None) -> tuple[tuple[str, ...], dict[str, Any]]:
    options = {"type": _path, "required": True, "metavar": metavar, "help": help}
    return ("-o", "--output"), options


_CASE = (
    _argument("case", type=_path, metavar="CASE.toml", help="case file"),
    _argument(
        "--set", action="extend", default=[], nargs="+", dest="overrides", metavar="KEY=VALUE",
        help="override a key of the case file, such as load.pressure=50",
    ),
)  # fmt: skip
_FIT_FILE = _argument("fit", type=_path, metavar="FIT.toml", help="fit file")
_NO_CACHE = _flag(
    "--no-cache",
    "assemble every shape, neither read nor write stored ones (ringwear info says where they are)",
)
_UNWRITTEN = "; nothing written"

_COMMANDS = {
    "run": _Command("compute one wear history", _run, (
        _output("RUN.h5"),
        *_CASE,
        _flag("--restart",
              "continue RUN.h5 where it was interrupted, or to a larger time.steps or time.end"),
        _flag("--overwrite", "replace what RUN.h5 holds, an interrupted run too"),
        _NO_CACHE,
        _argument("--plot", type=_path, metavar="FIG.png", help="draw the history at the end"),
    ), solves=True, stopped=f" before the first step{_UNWRITTEN}"),
    "sweep": _Command("compute every case of a study, or go on with it", _sweep, (
        _argument("study", type=_path, metavar="STUDY.toml", help="study file"),
        _output("DIR"),
        _argument("--ranks-per-case", type=int, default=1, metavar="M",
                  help="ranks that share a case; must divide their number (default: %(default)s)"),
        _argument("--slice", type=_slice, metavar="I/N", dest="part",
                  help="compute the I-th of N slices only; without it, slices are merged"),
        _flag("--retry-failed", "compute failed cases again as well"),
        _flag("--mix-versions",
              "go on where another version of this program has computed cases; the variable "
              "version tells them apart"),
        _flag("--dry-run",
              "count cases and operators, estimate memory and time; write nothing"),
        _NO_CACHE,
    ), solves=True, stopped="; the same command goes on"),
    "fit": _Command("find parameters of the wear law from measurements, with intervals", _fit, (
        _FIT_FILE,
        _output("DIR"),
        _flag("--dry-run", "print the intervals to be expected from the start; write nothing"),
        _flag("--restart", "use the optima that an interrupted fit has stored"),
        _flag("--compare", "fit the laws of [compare] as well"),
        _NO_CACHE,
    ), solves=True, stopped=f" before the first start{_UNWRITTEN}"),
    "design": _Command("find the next tests that tell most, from [design] of a fit file", _design, (
        _FIT_FILE,
        _output("DIR"),
        _argument("--after", type=_path, metavar="DIR",
                  help="folder of a fit whose information counts"),
        _argument("--criterion", choices=("D", "A", "eig"), help="instead of that of the fit file"),
        _NO_CACHE,
    ), solves=True, stopped=_UNWRITTEN),
    "measure": _Command(
        "compute steady wear rates and friction from a rig's own files, by no model", _measure, (
        _argument("sources", type=_path, nargs="+", metavar="W.csv or MEASURE.toml",
                  help="records of one rig, or a measure file alone"),
        _output("DIR"),
        _argument("--case", type=_path, metavar="RIG.toml",
                  help="case file of the rig, of records: rings, load, speed, densities"),
        _argument("--masses", type=_path, metavar="M.csv", help="weighings, of records"),
    ), stopped=_UNWRITTEN),
    "plot": _Command(
        "draw the figures of the paper from result files, or those of a sweep", _plot, (
        _argument("results", type=_path, nargs="+", metavar="RUN.h5 or DIR"),
        _output("FIG.png"),
        _argument("--panels", metavar="LIST",
                  help="any of wear, pressure, section, stress, depth, interfaces, mises, "
                  "penetration, approach, force, torque, energy, volume, rate, pv, through, in "
                  f"this order (default: {PANELS})"),
        _argument("--steps", metavar="LIST",
                  help="steps whose profiles are drawn, such as 1,50,100 (default: first and "
                  "quarters)"),
        _argument("--times", metavar="LIST",
                  help="or times, nearest to which states are stored, in s or such as "
                  '"0.5 h, 2 h"'),
        _argument("--profiles-of", type=_path, nargs="+", metavar="RUN.h5",
                  help="draw the profiles of these files only (default: of all)"),
    ), stopped=_UNWRITTEN),
    "export": _Command("write a result file for ParaView or a spreadsheet", _export, (
        _argument("result", type=_path, metavar="RUN.h5"),
        _output("OUT", ".vtkhdf: contours of both bodies at all stored times; .csv: histories"),
        _argument("--revolve", type=int, metavar="N",
                  help="write the surfaces, revolved in N segments, instead of the contours"),
        _argument("--scale", type=float, metavar="S",
                  help="add the displacements, S times magnified, to the points (default: 0)"),
        _flag("--fields",
              "write the fields along the contact line to .csv instead of the histories"),
        _flag("--stress",
              "write the stresses of [stress]: its grid to .vtkhdf, its points to .csv"),
        _flag("--interfaces",
              "write the stresses along the interfaces between layers to .vtkhdf or .csv"),
    ), stopped=_UNWRITTEN),
    "report": _Command("write a page of stored results that opens in any browser", _report, (
        _argument("results", type=_path, metavar="RUN.h5 or DIR"),
        _output("REPORT.html"),
    ), stopped=_UNWRITTEN),
    "explore": _Command(
        "serve a page on this machine with sliders for a case's numbers", _explore, (
        *_CASE,
        _argument("--port", type=_port, default=0, metavar="N",
                  help="of the address (default: any free one)"),
        _flag("--no-browser", "print the address, but open no browser"),
        _NO_CACHE,
    ), solves=True),
    "laws": _Command(
        "print what the wear laws of a case do, and test their derivatives", _laws, _CASE),
    "verify": _Command(
        "run the reference solutions; print error and observed order of each", _verify, (),
        solves=True),
    "info": _Command("print versions, MPI and PETSc builds, ranks and threads", _info, (
        _argument("--schema", nargs="*", metavar="WORD",
                  help="print the keys of case, study, fit and measure files, or of one of these: "
                  "case, study, fit or measure; behind it, or alone, a word of the rows to print, "
                  "such as wear.lower"),
    )),
}  # fmt: skip


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="ringwear",
        description="Wear histories of ring-on-ring and ring-on-disc tests by boundary elements.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"ringwear {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, command in _COMMANDS.items():
        summary = command.summary
        arguments = commands.add_parser(
            name,
            help=summary,
            description=f"{summary[0].upper()}{summary[1:]}.",
            epilog=EPILOG,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        for flags, options in command.arguments:
            arguments.add_argument(*flags, **options)
    return parser


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
        self._said = False
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
        if not self._said and not self._said_elsewhere():
            self._said = True
            if self.together is not None:
                self._notices = [
                    self.together.isend(None, rank, _SAID)
                    for rank in range(self.comm.size)
                    if rank != self.comm.rank
                ]
            with suppress(OSError):  # nobody can be told
                lines = "\n".join(f"ringwear: {line}" for line in message.splitlines())
                print(lines, file=sys.stderr, flush=True)

    def _said_elsewhere(self) -> bool:
        """Tell whether another rank has said why the command ends."""
        if self.together is None:
            return False
        from mpi4py import MPI

        return bool(self.together.Iprobe(MPI.ANY_SOURCE, _SAID))


def _place(error: BaseException) -> str:
    """Return the file and line that raised an error."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{last.filename}, line {last.lineno}"


def _why_untold() -> str:
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
        return _UNWRITTEN
    command = _COMMANDS.get(words[0]) if words else None
    return "" if command is None else command.stopped


@contextmanager
def _without_other_processes() -> Iterator[None]:
    """Have Open MPI start without looking for other processes, where no launcher started this one.

    That takes a quarter of a second less. What is set here is gone before anything else is started.
    """
    settings = {} if any(name in os.environ for name in _LAUNCHED) else _ISOLATED
    mine = {name: value for name, value in settings.items() if name not in os.environ}
    os.environ.update(mine)
    try:
        yield
    finally:
        for name in mine:
            del os.environ[name]


def _main(words: Sequence[str], world: _World, signals: StopAtOnce) -> int:
    cut = words.index("--") if "--" in words else len(words)

    try:
        with _without_other_processes():
            from mpi4py import MPI
    except (ImportError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        print(f"ringwear: MPI for Python (mpi4py) does not load: {reason}", file=sys.stderr)
        return 1

    from ringwear_par.options import start_petsc
    from ringwear_par.parallel import as_ours, claim_blas_memory, is_shortage

    world.comm = comm = MPI.COMM_WORLD
    world.together = comm.Dup() if comm.size > 1 else None
    _start_logging(comm.rank)
    if comm.rank > 0:  # --help and --version are for one rank to print
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
    elif isinstance(sys.stdout, TextIOWrapper):  # any title can be printed
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        if not words:
            _parser().print_help()
            return 0
        args = _parser().parse_args(words[:cut])
        command = _COMMANDS[args.command]
        _check_launch(comm.size)
        if args.command == "verify" or getattr(args, "no_cache", False):
            from ringwear_par.elasticity import pair_cache

            os.environ[pair_cache.VARIABLE] = ""  # no cache
        if command.solves or words[cut + 1 :]:
            start_petsc(words[cut + 1 :])
        if command.solves:
            claim_blas_memory(comm)
        command.run(args, comm)
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
        untold = _why_untold() if isinstance(error, OSError) else ""
        if untold:
            with suppress(OSError):
                print(f"ringwear: standard output: {untold}", file=sys.stderr, flush=True)
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
