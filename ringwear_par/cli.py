"""The ``ringwear`` command: arguments, errors and exit statuses, alike on one rank and on many.

It works on the world's communicator, and starts PETSc with the arguments behind ``--`` before any
other module imports it.
"""

import argparse
import logging
import os
import sys
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from ringwear_par import __version__
from ringwear_par.errors import InputError, RingwearError

#: how long a rank that fails waits for the others to fail alike
GRACE_SECONDS = 10.0
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
        raise InputError(f"{message} (see {self.prog} --help; PETSc's options go behind --)")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="ringwear",
        description="Wear histories of ring-on-ring and ring-on-disc tests by boundary elements.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"ringwear {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, text: str) -> argparse.ArgumentParser:
        return commands.add_parser(
            name,
            help=text,
            description=text[0].upper() + text[1:] + ".",
            epilog=EPILOG,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )

    run = command("run", "compute one wear history")
    run.add_argument("-o", "--output", type=Path, required=True, metavar="RUN.h5")
    _add_case(run)
    run.add_argument(
        "--restart", action="store_true",
        help="continue RUN.h5 where it was interrupted, or to a larger time.steps or time.end",
    )  # fmt: skip
    run.add_argument(
        "--overwrite", action="store_true",
        help="replace what RUN.h5 holds, an interrupted run too",
    )  # fmt: skip
    run.add_argument("--plot", type=Path, metavar="FIG.png", help="draw the history at the end")

    sweep = command("sweep", "compute every case of a study, or go on with it")
    sweep.add_argument("study", type=Path, metavar="STUDY.toml", help="study file")
    sweep.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    sweep.add_argument(
        "--ranks-per-case", type=int, default=1, metavar="M",
        help="ranks that share a case; must divide their number (default: %(default)s)",
    )  # fmt: skip
    sweep.add_argument(
        "--slice", type=_slice, metavar="I/N", dest="part",
        help="compute the I-th of N slices only; without it, slices are merged",
    )  # fmt: skip
    sweep.add_argument(
        "--retry-failed", action="store_true", help="compute failed cases again as well"
    )
    sweep.add_argument(
        "--mix-versions", action="store_true",
        help="go on where another version of this program has computed cases; the variable version "
        "tells them apart",
    )  # fmt: skip
    sweep.add_argument(
        "--dry-run", action="store_true",
        help="count cases and operators, estimate memory and time; write nothing",
    )  # fmt: skip

    plot = command("plot", "draw the figures of the paper from result files, or those of a sweep")
    plot.add_argument("results", type=Path, nargs="+", metavar="RUN.h5 or DIR")
    plot.add_argument("-o", "--output", type=Path, required=True, metavar="FIG.png")
    plot.add_argument(
        "--panels", metavar="LIST",
        help=f"any of wear, penetration, pressure, section, in this order (default: {PANELS})",
    )  # fmt: skip
    plot.add_argument(
        "--steps", metavar="LIST",
        help="steps whose profiles are drawn, such as 1,50,100 (default: first and quarters)",
    )  # fmt: skip

    plot.add_argument(
        "--profiles-of", type=Path, nargs="+", metavar="RUN.h5",
        help="draw the profiles of these files only (default: of all)",
    )  # fmt: skip

    export = command("export", "write a result file for ParaView or a spreadsheet")
    export.add_argument("result", type=Path, metavar="RUN.h5")
    export.add_argument(
        "-o", "--output", type=Path, required=True, metavar="OUT",
        help=".vtp: contours of both bodies; .vtu: their surfaces, revolved; .csv: histories",
    )  # fmt: skip
    export.add_argument(
        "--time", type=float, metavar="T",
        help="take the stored state nearest to this time, s (default: the last)",
    )  # fmt: skip
    export.add_argument(
        "--revolve", type=int, metavar="N", help="segments of the revolved surfaces (default: 72)"
    )
    export.add_argument(
        "--scale", type=float, metavar="S",
        help="add the displacements, S times magnified, to the points (default: 0)",
    )  # fmt: skip
    export.add_argument(
        "--fields", action="store_true",
        help="write the fields along the contact line to .csv instead of the histories",
    )  # fmt: skip

    laws = command("laws", "print what the wear laws of a case do, and test their derivatives")
    _add_case(laws)

    command("verify", "run the reference solutions; print error and observed order of each")
    info = command("info", "print versions, MPI and PETSc builds, ranks and threads")
    info.add_argument("--schema", action="store_true", help="print every key of the case file")
    return parser


def _add_case(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("case", type=Path, metavar="CASE.toml", help="case file")
    parser.add_argument(
        "--set", action="extend", default=[], nargs="+", dest="overrides", metavar="KEY=VALUE",
        help="override a key of the case file, such as load.pressure=50",
    )  # fmt: skip


def _slice(text: str) -> tuple[int, int]:
    first, _, last = text.partition("/")
    if not (first.isdecimal() and last.isdecimal() and 1 <= int(first) <= int(last)):
        raise argparse.ArgumentTypeError(f"{text}: must be I/N with I from 1 to N, such as 2/8")
    return int(first), int(last)


def _run(args: argparse.Namespace, comm: Any) -> None:
    from ringwear_par.results.run import run_case

    run_case(
        args.case, args.output, args.overrides, comm=comm, restart=args.restart,
        overwrite=args.overwrite, figure=args.plot,
    )  # fmt: skip


def _sweep(args: argparse.Namespace, comm: Any) -> None:
    from ringwear_par.studies.sweep import run_sweep

    run_sweep(
        args.study, args.output, comm, ranks_per_case=args.ranks_per_case, part=args.part,
        retry_failed=args.retry_failed, mix_versions=args.mix_versions, dry_run=args.dry_run,
    )  # fmt: skip


def _plot(args: argparse.Namespace, comm: Any) -> None:
    from ringwear_par.parallel import on_first_rank

    folders = [path for path in args.results if path.is_dir()]
    if not folders:
        from ringwear_par.results.figures import plot_files

        panels, steps = args.panels or PANELS, args.steps or ""
        on_first_rank(
            comm,
            lambda: plot_files(args.results, args.output, panels, steps, args.profiles_of or ()),
        )
        return
    from ringwear_par.studies.figures import plot_sweep

    if len(args.results) > 1:
        raise InputError(f"{folders[0]}: is a folder; must be the only thing to be drawn")
    for name in ("panels", "steps", "profiles_of"):
        if getattr(args, name) is not None:
            raise InputError(
                f"--{name.replace('_', '-')}: must be absent where {folders[0]}, a folder, is "
                "drawn; it is for result files"
            )
    on_first_rank(comm, lambda: plot_sweep(folders[0], args.output))


def _export(args: argparse.Namespace, comm: Any) -> None:
    from ringwear_par.parallel import on_first_rank
    from ringwear_par.results.export import export

    told = on_first_rank(
        comm,
        lambda: export(args.result, args.output, args.time, args.revolve, args.scale, args.fields),
    )
    print(told)


def _laws(args: argparse.Namespace, comm: Any) -> None:
    from ringwear_par.cases.law_trials import check_laws
    from ringwear_par.parallel import on_first_rank

    on_first_rank(comm, lambda: check_laws(args.case, args.overrides))


def _verify(args: argparse.Namespace, comm: Any) -> None:
    from ringwear_par.verification.verify import verify

    verify(comm)


def _info(args: argparse.Namespace, comm: Any) -> None:
    if args.schema:
        from ringwear_par.cases.schema import schema

        print(schema())
        return
    from ringwear_par.info import print_info

    print_info(comm)


_COMMANDS = {
    "run": _run, "sweep": _sweep, "plot": _plot, "export": _export, "laws": _laws,
    "verify": _verify, "info": _info,
}  # fmt: skip


def _check_launch(size: int) -> None:
    for name in ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE"):
        launched = os.environ.get(name)
        if launched is not None and launched.isdecimal() and int(launched) != size:
            raise InputError(
                f"{name} = {launched} but MPI has {size} rank(s): mpirun and mpi4py belong to "
                "different MPI libraries (see ringwear info)"
            )


def _others_come(together: Any) -> bool:
    """Wait a little for the other ranks to fail as well; they may have gone on to a collective."""
    if together is None:
        return True
    request, started = together.Ibarrier(), time.monotonic()
    while not request.Test():
        if time.monotonic() - started > GRACE_SECONDS:
            return False
        time.sleep(0.001)
    return True


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status. Collective on COMM_WORLD."""
    words = list(sys.argv[1:] if argv is None else argv)
    cut = words.index("--") if "--" in words else len(words)

    try:
        from mpi4py import MPI
    except (ImportError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        print(f"ringwear: MPI for Python (mpi4py) does not load: {reason}", file=sys.stderr)
        return 1

    from ringwear_par.options import start_petsc

    comm = MPI.COMM_WORLD
    together = comm.Dup() if comm.size > 1 else None
    logging.basicConfig(
        format="ringwear: %(message)s",
        level=logging.INFO if comm.rank == 0 else logging.ERROR,
        stream=sys.stderr,
    )
    logging.getLogger("matplotlib").setLevel(logging.WARNING)
    if comm.rank > 0:  # --help and --version are for one rank to print
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
    try:
        args = _parser().parse_args(words[:cut])
        _check_launch(comm.size)
        start_petsc(words[cut + 1 :])
        _COMMANDS[args.command](args, comm)
        sys.stdout.flush()
        return 0
    except RingwearError as error:
        alike = _others_come(together)
        if comm.rank == 0 or not alike:
            told = "\n".join(f"ringwear: {line}" for line in str(error).splitlines())
            print(told, file=sys.stderr, flush=True)
        if not alike:
            comm.Abort(error.exit_status)
        return error.exit_status
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception:
        traceback.print_exc()
        sys.stderr.flush()
        if comm.size > 1:  # the other ranks would wait for this one for ever
            comm.Abort(1)
        return 1
