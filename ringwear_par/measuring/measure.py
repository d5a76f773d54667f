"""``rw.measure`` and ``ringwear measure``: the numbers of the standards from a rig's own files."""

import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.keys import read_keys
from ringwear_par.errors import InputError, legible
from ringwear_par.files.folders import MEASURE, MEASURED_ROWS, RECORDS, check_folder
from ringwear_par.files.writing import announce_replacement, closing_line
from ringwear_par.measuring.analysis.numbers import coverage_fault, numbers_of
from ringwear_par.measuring.analysis.repeats import repeats_of
from ringwear_par.measuring.definition.measure_file import read_measure, tables_of
from ringwear_par.measuring.definition.problem import Problem
from ringwear_par.measuring.measure_result import MeasureResult
from ringwear_par.version import __version__

Source = str | Path | Mapping[str, Any] | Sequence[str | Path]
_TOML = ".toml"
#: files of the folder of a measurement; the first one is written last, when the folder is complete
FILES = (MEASURE, MEASURED_ROWS, RECORDS)


def measure(
    source: Source,
    *,
    case: Case | str | Path | Mapping[str, Any] | None = None,
    masses: str | Path | None = None,
) -> MeasureResult:
    """Return steady wear rates, friction and their budgets from records of a rig; no model.

    Not collective: it needs neither MPI nor PETSc.

    Parameters
    ----------
    source : the name of a measure file, or the same as a dict; or names of records, with ``case``.
    case : of the rig, of records: the name of its file, a Case, or its tables.
    masses : the name of a table of weighings, of records.

    Returns
    -------
    MeasureResult : ``.summary()``, ``.to_dict()``, ``.plot()``, ``.save(folder)``.

    Raises
    ------
    InputError : all faults of the files, each with its file and its line or key.

    Examples
    --------
    >>> import ringwear_par as rw
    >>> print(rw.measure("scripts/measure/measure.toml").summary().partition(" from")[0])
    specific wear rate 1.39e-06 mm3/(N m)
    """
    return measure_problem(_problem(source, case, masses))


def measure_problem(problem: Problem) -> MeasureResult:
    """Return the numbers of a problem that was read.

    Raises
    ------
    InputError : records with too few readings where they are needed.
    """
    faults = [coverage_fault(test, problem.limits.start) for test in problem.tests]
    if any(faults):
        raise InputError(*(f"{problem.name}: {fault}" for fault in faults if fault))
    tests = tuple(numbers_of(test, problem) for test in problem.tests)
    versions = {
        "version": __version__, "python_version": platform.python_version(),
        "numpy_version": np.__version__,
    }  # fmt: skip
    return MeasureResult(problem, tests, repeats_of(tests), versions)


def run_measure(
    sources: Sequence[Path], folder: Path, case: Path | None, masses: Path | None
) -> str:
    """Measure and write the outcome to a folder; return its summary. On one rank."""
    files = [path for path in sources if path.suffix.lower() == _TOML]
    if files and len(sources) > 1:
        raise InputError(f"{files[0]}: a measure file must be the only file of the command")
    for option, path in (("--case", case), ("--masses", masses)):
        if path is not None and not path.is_file():
            fault = "is not a file" if path.exists() else "cannot be read: no such file"
            raise InputError(f"{option} {legible(str(path))}: {fault}")
    problem = _problem(files[0] if files else sources, case, masses)
    check_folder(folder, FILES, "measure")
    result = measure_problem(problem)
    announce_replacement(folder / FILES[0])
    result.save(folder)
    return f"{result.summary()}\n{closing_line(folder, FILES)}"


def _problem(source: Source, case: Any, masses: str | Path | None) -> Problem:
    """Return the problem of a measure file, or of records and the case of their rig.

    Raises
    ------
    InputError : its faults; too many or too few of these.
    """
    if isinstance(source, Mapping) or (
        isinstance(source, str | Path) and Path(source).suffix.lower() == _TOML
    ):
        file = "measure" if isinstance(source, Mapping) else legible(str(source))
        for name, value in (("case", case), ("masses", masses)):
            if value is not None:
                raise InputError(
                    f"{name} = {legible(str(value))}: must be absent beside {file}, which "
                    "names its own"
                )
        return read_measure(source)
    records = [source] if isinstance(source, str | Path) else list(source)
    if not records:
        raise InputError(
            "measure: no record; must be names of record files, or of one measure file (.toml)"
        )
    if case is None:
        raise InputError(
            f"{legible(str(records[0]))}: case is missing: --case RIG.toml (a case file with "
            "rings, load and speed) or a measure file (.toml) must be given"
        )
    if isinstance(case, Case):
        if case.rebuild is None:
            raise InputError("case: its text does not tell its keys; must be one that was read")
        case = read_keys(case.text)
    return read_measure(tables_of(records, case, masses))
