"""The commands: one table of their help texts, functions and arguments.

The function of a command is loaded when the command is run. Its parameters have the names of the
arguments.
"""

import argparse
import math
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from ringwear_par.errors import InputError, legible
from ringwear_par.version import __version__


def _number(
    read: Callable[[str], float], low: float, high: float, must: str = ""
) -> Callable[[str], float]:
    """Return the type of numbers from low to high; a refusal says what they must be."""

    def number(text: str) -> float:
        try:
            value = read(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            must_be = must or f"from {low:g} to {high:g}"
            raise argparse.ArgumentTypeError(f"{legible(text)}: must be {must_be}")
        return value

    return number


def _mm(text: str) -> float:
    from ringwear_par.cases.units import in_unit
    from ringwear_par.cases.values import RejectedError

    try:
        return float(in_unit(text, "mm"))
    except RejectedError as error:
        raise ValueError from error


_width = _number(_mm, 1e-3, 1e6, "mm, or such as '3.5 in'")
_depth = _number(
    lambda text: _mm(text) if text[-1:].isalpha() else math.nan, 1e-12, 1e6,
    "a length with its unit, such as '20 um'",
)  # fmt: skip
_percent = _number(
    lambda text: float(text.strip().removesuffix("%")), 1.0, 99.0,
    "a percentage, 1% to 99%, such as 15%",
)  # fmt: skip


def _figure(text: str) -> Any:
    """Return the picture of a run, of this name."""
    return import_module("ringwear_par.pictures.figures").FigureFile(Path(text))


class _Arguments(argparse.ArgumentParser):
    """Arguments of a command. Complaints are said once, not once per rank."""

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{legible(message, 300)} (see {self.prog} --help)")

    def flag(self, name: str, help: str) -> None:
        self.add_argument(name, action="store_true", help=help)

    def path(self, *flags: str, **options: Any) -> None:
        self.add_argument(*flags, type=Path, **options)

    def output(self, metavar: str, help: str = "file to write") -> None:
        self.path("-o", "--output", required=True, metavar=metavar, help=help)

    def folder(self) -> None:
        options = {"required": True, "metavar": "DIR", "dest": "folder"}
        self.path("-o", "--output", help="folder to write", **options)

    def overrides(self) -> None:
        self.add_argument(
            "--set", action="extend", default=[], nargs="+", dest="overrides", metavar="KEY=VALUE",
            help="override a key of the case file, such as load.pressure=50",
        )  # fmt: skip

    def case(self) -> None:
        self.path("path", metavar="CASE.toml", help="case file")
        self.overrides()

    def fit_file(self) -> None:
        self.path("source", metavar="FIT.toml", help="fit file")
        self.folder()

    def draws(self, number: int, least: int = 1) -> None:
        text = "penetration whose time to predict, '20 um'"
        self.add_argument("--depth", type=_depth, metavar="DEPTH", help=text)
        text, kind = "number of draws (default: %(default)s)", _number(int, least, 10**7)
        self.add_argument("--draws", type=kind, default=number, metavar="N", help=text)
        text, kind = "seed of the draws (default: %(default)s)", _number(int, 0, 10**9)
        self.add_argument("--seed", type=kind, default=0, metavar="N", help=text)


# fmt: off
def parser() -> argparse.ArgumentParser:
    """Return the parser of a command line."""
    lines: list[str] = []
    whole = _Arguments(
        prog="ringwear", usage="ringwear COMMAND ... [-- OPTIONS OF PETSC]",
        description="Wear histories of ring-on-ring and ring-on-disc tests by boundary elements, "
        "and wear laws from measurements.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    whole.add_argument("--version", action="version", version=f"ringwear {__version__}")
    commands = whole.add_subparsers(
        dest="command", required=True, prog="ringwear", metavar="COMMAND", help=argparse.SUPPRESS
    )

    def command(name: str, summary: str, function: str, example: str, kind: str = "") -> _Arguments:
        lines.append(f"  {name:9}{summary}")
        a = commands.add_parser(
            name, description=f"{summary[0].upper()}{summary[1:]}.",
            epilog=f"example:\n  {example}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        a.set_defaults(load=(function, kind))
        return a

    lines.append("\nsimulate:")
    a = command(
        "run", "compute one wear history", "results.run:run_case",
        "ringwear run case.toml -o run.h5\n  "
        "ringwear run case.toml -o soft.h5 --set load.pressure=50 wear.lower.k='1e-5 mm3/(N m)'",
        "solves")
    a.case()
    a.output("RUN.h5")
    a.flag("--restart",
           "continue RUN.h5 where it was interrupted, or to a larger time.steps or time.end")
    a.flag("--overwrite", "replace RUN.h5, even if it holds an interrupted run")
    a.add_argument("--plot", type=_figure, dest="figure", metavar="FIG.png",
                   help="draw the history at the end")
    a = command(
        "sweep", "compute every case of a study, or continue an interrupted sweep",
        "studies.sweep:run_sweep", "mpirun -n 4 ringwear sweep study.toml -o out/study",
        "solves")
    a.path("study", metavar="STUDY.toml", help="study file")
    a.folder()
    a.add_argument("--ranks-per-case", type=int, default=1, metavar="M",
                   help="ranks that share a case; must divide the number of ranks (default: "
                   "%(default)s)")
    a.flag("--retry-failed", "compute the blocks of failed cases again")
    a.flag("--dry-run", "count cases, compute one block, which stays, and estimate time by it")
    a = command(
        "plot", "draw figures of runs, of a sweep, or of the rig of a case file",
        "reports.plot:plot_stored",
        "ringwear plot run.h5 soft.h5 -o runs.png --panels wear,penetration,pressure\n  "
        "ringwear plot out/study -o study.png",
        "serial")
    a.path("results", nargs="+", metavar="RUN.h5, DIR or CASE.toml")
    a.output("FIG.png")
    a.add_argument("--panels", metavar="LIST",
                   help="panels in the order wanted, of wear, pressure, section, stress, depth, "
                   "interfaces, mises, penetration, approach, force, torque, friction, energy, "
                   "volume, rate, through, pv (default: wear,penetration)")
    a.add_argument("--steps", metavar="LIST",
                   help="steps whose profiles are drawn, such as 1,50,100 (default: the first, and "
                   "at each quarter)")
    a.add_argument("--times", metavar="LIST",
                   help="times instead of steps, in s or such as '0.5 h, 2 h'; the nearest stored "
                   "profiles are drawn")
    a.add_argument("--width", type=_width, metavar="WIDTH",
                   help="of the figure, in mm or such as '3.5 in'; texts stay as large (a column "
                   "of a journal: 90 mm; a page: 180 mm)")
    a.add_argument("--dpi", type=_number(int, 50, 2400), metavar="N",
                   help="resolution of bitmaps (default: 200)")
    a = command(
        "report", "write one HTML page of a run, sweep, fit, design, prediction or measurement",
        "reports.report:report", "ringwear report run.h5 -o run.html", "serial")
    a.path("source", metavar="RUN.h5 or DIR")
    a.output("REPORT.html")
    a = command(
        "explore", "open a page in the browser with sliders for the numbers of a case",
        "explorer.explore:explore", "ringwear explore case.toml", "solves")
    a.case()
    a.add_argument("--port", type=_number(int, 0, 65535), default=0, metavar="N",
                   help="port of the page's address (default: any free one)")
    a.add_argument("--no-browser", action="store_false", dest="browser",
                   help="print the address, but open no browser")

    lines.append("\nlaboratory:")
    a = command(
        "measure", "compute steady wear rates and friction from a rig's files, without a model",
        "measuring.measure:run_measure",
        "ringwear measure W1.csv W2.csv --case rig.toml --masses masses.csv -o out/rates",
        "serial")
    a.path("sources", nargs="+", metavar="W.csv or MEASURE.toml",
           help="record files of one rig, or one measure file")
    a.folder()
    a.path("--case", metavar="RIG.toml",
           help="case file of the rig (rings, load, speed, densities), with record files")
    a.path("--masses", metavar="M.csv", help="table of weighings, with record files")
    a = command(
        "fit", "fit parameters of the wear law to measurements, with confidence intervals",
        "identification.fit:run_fit",
        "ringwear fit fit.toml -o out/fit\n  ringwear fit fit.toml -o out/fit --dry-run",
        "solves")
    a.fit_file()
    a.flag("--dry-run", "print how well the keys would be known; write nothing")
    a.flag("--compare", "fit the laws of [compare] as well")
    a = command(
        "design", "choose the most informative next tests, from [design] of a fit file",
        "identification.design.design:run_design",
        "ringwear design fit.toml -o out/plan --after out/fit", "solves")
    a.fit_file()
    a.path("--after", metavar="DIR", help="folder of a fit, whose measurements count as well")
    a.add_argument("--criterion", choices=("D", "A"),
                   help="criterion, instead of design.criterion of the fit file")
    a = command(
        "predict", "predict a case that was not tested, with an interval, from a fit",
        "prediction.predict:run_predict",
        "ringwear predict out/fit case.toml -o out/prediction --set load.pressure=60", "solves")
    a.path("fit", metavar="FITDIR", help="folder of a fit")
    a.path("case", metavar="CASE.toml", help="case file")
    a.folder()
    a.overrides()
    a.add_argument("--of", default="next specimen", metavar="WHOM",
                   help="'next specimen' (the default), 'material' or a specimen of the fit")
    a.draws(1000)
    a = command(
        "follow", "monitor a running test: its specimen so far, and when the test may end",
        "monitoring.follow:run_follow",
        "ringwear follow fit.toml -o out/follow --after out/fit --to 5%", "solves")
    a.fit_file()
    a.path("--after", metavar="FITDIR",
           help="folder of the fit of earlier tests (default: fit the file's other tests)")
    a.add_argument("--test", metavar="NAME", help="experiment that runs (default: the last one)")
    a.add_argument("--to", type=_percent, default="10%", metavar="PERCENT",
                   help="half width of the interval of k that is asked for (default: 10%%)")
    a.draws(20_000, 2000)
    a.flag("--once", "answer once, by the readings that are there, and end")

    lines.append("\nother:")
    a = command(
        "export", "write stored results for ParaView or a spreadsheet",
        "reports.spreadsheets:export", "ringwear export run.h5 -o run.csv", "serial")
    a.path("run", metavar="RUN.h5 or DIR")
    a.output("OUT", ".vtkhdf: stored boundaries of both bodies, else the grid of stresses; .csv: "
             "histories of a run, cases of a sweep, tests of a fit or measurement; .xlsx: all "
             "their tables (openpyxl)")
    command(
        "verify", "check that this installation computes rightly: ten numbers, in seconds",
        "verify:verify", "ringwear verify", "solves")
    a = command(
        "info", "print versions, MPI and PETSc builds, ranks and threads, or all keys of files",
        "info:print_info", "ringwear info --schema case wear.lower")
    a.add_argument("--schema", nargs="*", metavar="WORD",
                   help="print the keys of all files, or of case, study, measure or fit files; a "
                   "further word, such as wear.lower, prints only the rows that contain it")
    whole.epilog = "\n".join([
        *lines, "",
        "ringwear COMMAND --help has the options of a command, with an example.",
        "Exit status: 0 done, 1 the computation failed or was stopped, 2 bad input.",
    ])
    return whole
# fmt: on


def parsed(words: Sequence[str]) -> dict[str, Any]:
    """Return the arguments of a command line; without words it asks for help.

    ``load`` is the function, as module:name in the package, and how it runs: "serial", on the first
    rank alone, which prints what it returns; "solves", collective and with PETSc; "", collective.

    Raises
    ------
    InputError : they are none; with the command whose help has its options.
    """
    whole = parser()
    arguments, unknown = whole.parse_known_args(words or ["--help"])
    if unknown:
        whole.prog = f"{whole.prog} {arguments.command}"
        whole.error(f"unrecognized arguments: {' '.join(unknown)}")
    return vars(arguments)


def loaded(function: str) -> Callable[..., Any]:
    """Return a function of the package, by its module:name."""
    module, name = function.split(":")
    found: Callable[..., Any] = getattr(import_module(f"ringwear_par.{module}"), name)
    return found
