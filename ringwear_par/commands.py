"""The commands: one table of their arguments, help texts and functions, and its parser.

The function of a command is loaded when the command is run. Its parameters have the names of the
arguments.
"""

import argparse
import difflib
import math
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from ringwear_par.errors import InputError, legible
from ringwear_par.version import __version__

#: end of the message of a command that is stopped before it has results
UNWRITTEN = "; nothing written"

#: what one can do, and how: printed where no command is typed
_TASKS = (
    ("simulate", "ringwear run CASE.toml -o RUN.h5", "one wear history"),
    ("sweep", "ringwear sweep STUDY.toml -o DIR", "many, over any keys of a case"),
    ("fit", "ringwear fit FIT.toml -o DIR", "a wear law from measurements, with intervals"),
    ("plan", "ringwear design FIT.toml -o DIR", "the most informative next tests"),
    ("predict", "ringwear predict DIR CASE.toml -o DIR", "other cases, as a fit knows them"),
    ("follow", "ringwear follow FIT.toml -o DIR", "a running test: k, and when it may end"),
    ("measure", "ringwear measure W.csv --case RIG.toml -o DIR", "wear rates without a model"),
)
#: flags and options of ``add_argument``
Argument = tuple[tuple[str, ...], dict[str, Any]]


@dataclass(frozen=True)
class Command:
    """A command, in the order of ``ringwear --help``."""

    #: for its help
    summary: str
    #: module and name of what does it
    function: str
    #: of it
    arguments: tuple[Argument, ...]
    #: whether the function runs on the first rank alone, and returns the text to be printed, if
    #: any; others are collective, and take the communicator ``comm``
    serial: bool = False
    #: whether it needs PETSc
    solves: bool = False
    #: end of the message where it is stopped before it has results
    stopped: str = ""
    #: command lines, for its help
    example: str = ""

    def load(self) -> Callable[..., Any]:
        """Return the function."""
        module, name = self.function.split(":")
        function: Callable[..., Any] = getattr(import_module(f"ringwear_par.{module}"), name)
        return function


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


def _width(text: str) -> float:
    """Return a width in mm."""
    from ringwear_par.cases.units import in_unit
    from ringwear_par.cases.values import RejectedError

    try:
        width = float(in_unit(text, "mm"))
    except (RejectedError, ValueError):
        width = math.nan
    if not 0.0 < width < math.inf:
        raise argparse.ArgumentTypeError(f"{legible(text)}: must be mm, or such as '3.5 in'")
    return width


def _dpi(text: str) -> int:
    if not (re.fullmatch("[0-9]{2,4}", text) and 50 <= int(text) <= 2400):
        raise argparse.ArgumentTypeError(f"{legible(text)}: must be a whole number, 50 to 2400")
    return int(text)


def _figure(text: str) -> Any:
    """Return the picture of a run, of this name."""
    return import_module("ringwear_par.pictures.figures").FigureFile(_path(text))


def _argument(*flags: str, **options: Any) -> Argument:
    return flags, options


def _flag(name: str, help: str) -> Argument:
    return (name,), {"action": "store_true", "help": help}


def _output(metavar: str, help: str = "file or folder to write", dest: str = "output") -> Argument:
    options = {"type": _path, "required": True, "metavar": metavar, "help": help, "dest": dest}
    return ("-o", "--output"), options


_CASE = (
    _argument("path", type=_path, metavar="CASE.toml", help="case file"),
    _argument(
        "--set", action="extend", default=[], nargs="+", dest="overrides", metavar="KEY=VALUE",
        help="override a key of the case file, such as load.pressure=50",
    ),
)  # fmt: skip
_FIT_FILE = _argument("source", type=_path, metavar="FIT.toml", help="fit file")
_FOLDER = _output("DIR", dest="folder")
_DEPTH = _argument("--depth", metavar="DEPTH", help="penetration whose time to predict, '20 um'")
_NO_CACHE = _flag(
    "--no-cache",
    "assemble every contact pair, neither read nor write stored ones (their folder: ringwear info)",
)

COMMANDS = {
    "run": Command("compute one wear history", "results.execution.run:run_case", (
        _output("RUN.h5"),
        *_CASE,
        _flag("--restart",
              "continue RUN.h5 where it was interrupted, or to a larger time.steps or time.end"),
        _flag("--overwrite", "replace RUN.h5, even if it holds an interrupted run"),
        _flag("--verbose", "print all key numbers, checks and seconds"),
        _NO_CACHE,
        _argument("--plot", type=_figure, dest="figure", metavar="FIG.png",
                  help="draw the history at the end"),
    ), solves=True, stopped=f" before the first step{UNWRITTEN}",
        example="ringwear run case.toml -o run.h5\n"
          "ringwear run case.toml -o soft.h5 --set load.pressure=50 wear.lower.k='1e-5 mm3/(N m)'"),
    "sweep": Command(
        "compute every case of a study, or continue an interrupted sweep",
        "studies.execution.sweep:run_sweep", (
        _argument("study", type=_path, metavar="STUDY.toml", help="study file"),
        _FOLDER,
        _argument("--ranks-per-case", type=int, default=1, metavar="M",
                  help="ranks that share a case; must divide the number of ranks (default: "
                  "%(default)s)"),
        _argument("--slice", type=_slice, metavar="I/N", dest="part",
                  help="compute the I-th of N slices only; a sweep without --slice merges them"),
        _flag("--retry-failed", "compute failed cases again as well"),
        _flag("--dry-run",
              "count cases and assemblies, estimate memory and time; write nothing"),
        _NO_CACHE,
    ), solves=True, stopped="; the same command goes on",
        example="mpirun -n 4 ringwear sweep study.toml -o out/study"),
    "fit": Command(
        "fit parameters of the wear law to measurements, with confidence intervals",
        "identification.fit_command:run_fit", (
        _FIT_FILE,
        _FOLDER,
        _flag("--dry-run", "print the intervals to expect if the starts are true; write nothing"),
        _flag("--restart", "continue an interrupted fit from its stored optima"),
        _flag("--overwrite", "start anew, even if DIR holds an interrupted fit"),
        _flag("--compare", "fit the laws of [compare] as well"),
        _NO_CACHE,
    ), solves=True, stopped=f" before the first start{UNWRITTEN}",
        example="ringwear fit fit.toml -o out/fit\n"
          "ringwear fit fit.toml -o out/fit --dry-run"),
    "design": Command(
        "choose the most informative next tests, from [design] of a fit file",
        "identification.test_design.design:run_design", (
        _FIT_FILE,
        _FOLDER,
        _argument("--after", type=_path, metavar="DIR",
                  help="folder of a fit, whose measurements count as well"),
        _argument("--criterion", choices=("D", "A", "eig"),
                  help="criterion, instead of design.criterion of the fit file"),
        _NO_CACHE,
    ), solves=True, stopped=UNWRITTEN,
        example="ringwear design fit.toml -o out/plan --after out/fit"),
    "predict": Command(
        "predict a case that was not tested, with an interval, from the folder of a fit",
        "prediction.predict:run_predict", (
        _argument("fit", type=_path, metavar="FITDIR", help="folder of a fit"),
        _argument("case", type=_path, metavar="CASE.toml", help="case file"),
        _FOLDER,
        _CASE[1],
        _argument("--of", default="next specimen", metavar="WHOM",
                  help="'next specimen' (the default), 'material' or a specimen of the fit"),
        _argument("--draws", type=int, default=1000, metavar="N",
                  help="number of histories (default: %(default)s)"),
        _argument("--seed", type=int, default=0, metavar="N",
                  help="seed of the draws (default: %(default)s)"),
        _DEPTH,
        _NO_CACHE,
    ), solves=True, stopped=UNWRITTEN,
        example="ringwear predict out/fit case.toml -o out/prediction --set load.pressure=60"),
    "follow": Command(
        "say what a running test tells of its specimen, and when it may end, as its file grows",
        "monitoring.follow:run_follow", (
        _FIT_FILE,
        _FOLDER,
        _argument("--after", type=_path, metavar="FITDIR",
                  help="folder of the fit of earlier tests (default: fit the file's other tests)"),
        _argument("--test", metavar="NAME", help="experiment that runs (default: the last one)"),
        _argument("--to", default="10%", metavar="PERCENT",
                  help="half width of the interval of k that is asked for (default: 10%%)"),
        _DEPTH,
        _argument("--draws", type=int, default=10_000, metavar="N",
                  help="number of draws (default: %(default)s)"),
        _argument("--seed", type=int, default=0, metavar="N",
                  help="seed of the draws (default: %(default)s)"),
        _flag("--once", "answer once, by the readings that are there, and end"),
        _NO_CACHE,
    ), solves=True, stopped=" before the first answer",
        example="ringwear follow fit.toml -o out/follow --after out/fit --to 5%"),
    "measure": Command(
        "compute steady wear rates and friction from a rig's files, without a contact model",
        "measuring.measure:run_measure", (
        _argument("sources", type=_path, nargs="+", metavar="W.csv or MEASURE.toml",
                  help="record files of one rig, or one measure file"),
        _FOLDER,
        _argument("--case", type=_path, metavar="RIG.toml",
                  help="case file of the rig (rings, load, speed, densities), with record files"),
        _argument("--masses", type=_path, metavar="M.csv",
                  help="table of weighings, with record files"),
    ), serial=True, stopped=UNWRITTEN,
        example="ringwear measure W1.csv W2.csv --case rig.toml --masses masses.csv -o out/rates"),
    "plot": Command(
        "draw figures from result files of runs, the folder of a sweep, or the rig of a case file",
        "studies.pictures.plot:plot_stored", (
        _argument("results", type=_path, nargs="+", metavar="RUN.h5, DIR or CASE.toml"),
        _output("FIG.png"),
        _argument("--panels", metavar="LIST",
                  help="any of wear, pressure, section, stress, depth, interfaces, mises, "
                  "penetration, approach, force, torque, friction, energy, volume, rate, "
                  "through, pv, in this order (default: wear,penetration)"),
        _argument("--steps", metavar="LIST",
                  help="steps whose profiles are drawn, such as 1,50,100 (default: the first, and "
                  "at each quarter)"),
        _argument("--times", metavar="LIST",
                  help="times instead of steps, in s or such as '0.5 h, 2 h'; the nearest stored "
                  "profiles are drawn"),
        _argument("--width", type=_width, metavar="WIDTH",
                  help="of the figure, in mm or such as '3.5 in'; texts stay as large (a column of "
                  "a journal: 90 mm; a page: 180 mm)"),
        _argument("--dpi", type=_dpi, metavar="N",
                  help="points of an inch, of pictures that are no drawings (default: 200)"),
        _argument("--profiles-of", type=_path, nargs="+", metavar="RUN.h5",
                  help="draw the profiles of these files only (default: of all)"),
    ), serial=True, stopped=UNWRITTEN,
        example="ringwear plot run.h5 soft.h5 -o runs.png --panels wear,penetration,pressure\n"
          "ringwear plot out/study -o study.png"),
    "export": Command(
        "write stored results for ParaView or a spreadsheet", "reports.spreadsheets:export", (
        _argument("run", type=_path, metavar="RUN.h5 or DIR"),
        _output("OUT", ".vtkhdf: contours of both bodies at all stored times; .csv: histories of a "
                "run, cases of a sweep, tests of a fit or measurement; .xlsx: all their tables "
                "(openpyxl)"),
        _argument("--decimal", choices=("point", "comma"), default="point",
                  help="decimal mark in .csv; with commas, semicolons are between the columns"),
        _argument("--revolve", type=int, dest="segments", metavar="N",
                  help="write the surfaces, revolved in N segments, instead of the contours"),
        _argument("--scale", type=float, metavar="S",
                  help="add the displacements, S times magnified, to the points (default: 0)"),
        _flag("--fields",
              "write the fields along the contact line to .csv instead of the histories"),
        _flag("--stress",
              "write the stresses of [stress]: its grid to .vtkhdf, its points to .csv"),
        _flag("--interfaces",
              "write the stresses along the interfaces between layers to .vtkhdf or .csv"),
    ), serial=True, stopped=UNWRITTEN,
        example="ringwear export run.h5 -o run.csv"),
    "report": Command(
        "write one HTML page of a run, a sweep, a fit, a design, a prediction or a measurement",
        "reports.report:report", (
        _argument("source", type=_path, metavar="RUN.h5 or DIR"),
        _output("REPORT.html"),
    ), serial=True, stopped=UNWRITTEN,
        example="ringwear report run.h5 -o run.html"),
    "explore": Command(
        "open a page in the browser with sliders for the numbers of a case",
        "explorer.server:explore", (
        *_CASE,
        _argument("--port", type=_port, default=0, metavar="N",
                  help="port of the page's address (default: any free one)"),
        _argument("--no-browser", action="store_false", dest="browser",
                  help="print the address, but open no browser"),
        _NO_CACHE,
    ), solves=True,
        example="ringwear explore case.toml"),
    "serve": Command(
        "answer programs that speak UM-Bridge with numbers of a case's histories",
        "functions.umbridge:serve", (
        *_CASE,
        _argument("--inputs", nargs="+", required=True, metavar="KEY",
                  help="numbers of the case that programs choose, such as wear.lower.k"),
        _argument("--outputs", nargs="+", required=True, metavar="NAME",
                  help="variables of histories: NAME at the last step, or NAME@t at a time"),
        _argument("--port", type=_port, default=4242, metavar="N",
                  help="port of the address (default: %(default)s; 0: any free one)"),
        _NO_CACHE,
    ), solves=True,
        example="ringwear serve case.toml --inputs wear.lower.k load.pressure "
          "--outputs penetration torque@3600"),
    "verify": Command(
        "check that this installation computes rightly: ten numbers and what they must be",
        "verify:verify", (), solves=True,
        example="ringwear verify"),
    "info": Command(
        "print versions, MPI and PETSc builds, ranks and threads, or all keys of files",
        "info:print_info", (
        _argument("--schema", nargs="*", metavar="WORD",
                  help="print the keys of all files, or of case, study, measure or fit files; a "
                  "further word, such as wear.lower, prints only the rows that contain it"),
    ),
        example="ringwear info --schema case wear.lower"),
}  # fmt: skip


class _Parser(argparse.ArgumentParser):
    """A parser whose complaints are said once, not once per rank."""

    def error(self, message: str) -> NoReturn:
        if flag := re.search(r"(--[\w-]+): expected one argument", message):
            message += f" behind it, which is written {flag[1]}=VALUE where it begins with -"
        raise InputError(
            f"{legible(message, 300)} (see {self.prog} --help; PETSc's options go behind --)"
        )


def overview() -> str:
    """Return the tasks of the program, a line each."""
    lines = [f"  {task:10}{line:47}{meaning}" for task, line, meaning in _TASKS]
    return "\n".join([
        "Wear histories of ring-on-ring and ring-on-disc tests, wear laws from measurements.", "",
        *lines, "",
        "ringwear --help names all commands; ringwear COMMAND --help its options, with an example.",
    ])  # fmt: skip


def check_command(word: str) -> None:
    """Refuse the first word of a command line if it is no command, and name the nearest one.

    Raises
    ------
    InputError : it is none.
    """
    if word in COMMANDS or word.startswith("-"):
        return
    near = difflib.get_close_matches(word.lower(), COMMANDS, n=1)
    hint = f" (did you mean {near[0]}?)" if near else ""
    raise InputError(
        f"{legible(word)}: unknown command{hint}; must be one of {', '.join(COMMANDS)}"
    )


def parsed(words: Sequence[str]) -> dict[str, Any]:
    """Return the arguments of a command line.

    Raises
    ------
    InputError : they are none; with the command whose help has its options.
    """
    whole = parser()
    arguments, unknown = whole.parse_known_args(words)
    if unknown:
        whole.prog = f"{whole.prog} {arguments.command}"
        whole.error(f"unrecognized arguments: {' '.join(unknown)}")
    return vars(arguments)


def parser() -> argparse.ArgumentParser:
    """Return the parser of a command line."""
    whole = _Parser(
        prog="ringwear",
        description="Wear histories of ring-on-ring and ring-on-disc tests by boundary elements.",
        epilog="Exit status: 0 done, 1 the computation failed or was stopped, 2 bad input.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    whole.add_argument("--version", action="version", version=f"ringwear {__version__}")
    commands = whole.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, command in COMMANDS.items():
        summary = command.summary
        arguments = commands.add_parser(
            name,
            help=summary,
            description=f"{summary[0].upper()}{summary[1:]}.",
            epilog=f"example:\n  {command.example.replace(chr(10), chr(10) + '  ')}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        for flags, options in command.arguments:
            arguments.add_argument(*flags, **options)
    return whole
