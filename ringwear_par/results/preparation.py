"""Preparation of ``ringwear run``: a case, an output to write, and the run that it continues."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from ringwear_par.cases.case import SAME_TIME, Case, Output
from ringwear_par.cases.files.keys import read_keys
from ringwear_par.cases.files.law_trials import law_sources
from ringwear_par.cases.files.reading import read_case
from ringwear_par.errors import InputError
from ringwear_par.files.writing import check_writable
from ringwear_par.history.refusals.cases import check_case
from ringwear_par.results.files import open_result, restored
from ringwear_par.results.result import Result
from ringwear_par.version import __version__

#: endings of names of result files
_ENDINGS = (".h5", ".hdf5", ".nc")


class Figure(Protocol):
    """A picture that is drawn of a result file."""

    def check(self, stored: Output | None) -> None:
        """Refuse a picture that cannot be written, or drawn from what a case stores."""

    def draw(self, results: Path) -> None:
        """Draw and write it."""


def prepare(
    path: Path,
    output: Path,
    overrides: Sequence[str],
    restart: bool,
    overwrite: bool,
    figure: Figure | None,
    ranks: int,
) -> tuple[Case, Result | None]:
    """Read and check all that a run needs, before any work. On one rank.

    Return the case, and the result of the run that it goes on with, if any.

    Raises
    ------
    InputError : all that is wrong.
    """
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
        if output.suffix and output.suffix not in _ENDINGS:
            raise InputError(
                f"{output}: its ending must be one of {', '.join(_ENDINGS)}; ringwear export "
                "writes tables of results"
            )
        if case is not None and not overwrite:
            before = _interrupted(output, case, restart)
    except InputError as error:
        faults += error.faults
    if figure is not None:
        try:
            figure.check(case.output if case is not None else None)
        except InputError as error:
            faults += error.faults
    if faults or case is None:
        raise InputError(*faults)
    return case, before


def _interrupted(output: Path, case: Case, restart: bool) -> Result | None:
    """Return the result to go on with; refuse to lose one that was interrupted.

    A run that is complete, or that failed, is replaced without a question.
    """
    if not output.exists():
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
    fault = _difference(before, case)
    if restart and not fault:
        return before
    if restart:
        raise InputError(f"{output}: {fault}")
    raise InputError(
        f"{output}: holds a run that was interrupted after step "
        f"{restored(before).progress.steps[0]}; "
        + (
            "it is one of another case, and --overwrite replaces it"
            if fault
            else "--restart continues it, --overwrite starts anew"
        )
    )


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
    if _continued(before.case) != _continued(case.stored_text):
        return (
            f"holds another case; --restart needs the same case, only {growing} and limits in "
            "[stop] may change"
        )
    reached = float(restored(before).state.time[0])
    if reached > case.time.end * (1.0 + SAME_TIME):
        return (
            f"holds {reached:g} s, and the case ends at {case.time.end:g} s: must be at least as "
            "long with --restart"
        )
    return ""


def _continued(text: str) -> dict[str, Any]:
    """Return those keys of a case that must be the same where a run goes on."""
    keys = read_keys(text)
    return {
        key: value
        for key, value in keys.items()
        if key not in ("title", "time.end", "time.steps") and not key.startswith("stop.")
    }
