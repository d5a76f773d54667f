"""A test design in the words of who makes the tests, and the folder that it is kept in."""

import io
import json
from pathlib import Path

import numpy as np

from ringwear_par.errors import ComputationError
from ringwear_par.files.folders import DESIGN, MAP, NEXT
from ringwear_par.files.writing import atomic_write, unwritable
from ringwear_par.identification.definition.candidates import Candidate
from ringwear_par.identification.definition.fitted_parameters import unit_of_key
from ringwear_par.identification.fit_folder import check
from ringwear_par.identification.test_design.design import DesignResult
from ringwear_par.identification.test_design.next_tests import next_tests
from ringwear_par.identification.test_design.search import Design

FILES = (DESIGN, NEXT, MAP)

_CRITERIA = {
    "D": "smallest volume of the confidence ellipsoid (D)",
    "A": "smallest mean variance over the widths of the bounds (A)",
    "eig": "largest expected gain of information (eig)",
}
#: designs that a summary shows
_LISTED = 5


def summary(design: DesignResult) -> str:
    """Return the outcome in a few lines."""
    problem, count = design.problem, len(design.designs[0].tests)
    lines = [
        f"{problem.name}: {count} of {len(design.candidates)} tests, "
        f"{_CRITERIA[design.criterion]}; measured as in {problem.experiments[0].name}; "
        f"{design.histories} histories"
    ]
    about = ", ".join(
        f"{p.key} = {v:.4g}{unit_of_key(problem, p.key)}"
        for p, v in zip(problem.parameters, design.nominal.tolist(), strict=True)
    )
    where = f"after {design.after}" if design.after else "at the start"
    spread = (
        f", and {design.draws - 1} draws around it" if design.draws > 1
        else "; without priors or an earlier fit (--after) it holds there only"
    )  # fmt: skip
    lines.append(f"{where}: {about}{spread}")
    names = [_tests(design, one) for one in design.designs[:_LISTED]]
    width = max(map(len, names))
    for name, one in zip(names, design.designs, strict=False):
        lines.append(f"  {name.ljust(width)}  {_spreads(design, one)}")
    seconds = sum(experiment.case.time.end for experiment in problem.experiments)
    planned = f"the fit file's{' again' if design.after else ''}, {seconds:g} s"
    lines.append(f"  {planned.ljust(width)}  {_spreads(design, design.planned)}")
    if design.failed:
        test, why = next(iter(design.failed.items()))
        lines.append(
            f"{len(design.failed)} tests cannot be computed and are left out: {name_of(test)}: "
            f"{why}"
        )
    return "\n".join(lines)


def _tests(design: DesignResult, one: Design) -> str:
    return " + ".join(name_of(design.candidates[i]) for i in one.tests)


def name_of(test: Candidate) -> str:
    """Return a test in a few words."""
    words = []
    if test.loads:
        unit = "MPa" if "load.pressure" in test.keys else "N"
        words.append(f"{' then '.join(f'{load:.4g}' for load in test.loads)} {unit}")
    if "load.omega" in test.keys:
        words.append(f"{test.keys['load.omega']:.4g} rad/s")
    words.append(f"{test.seconds:.4g} s")
    if test.instants_vary:
        at = ", ".join(f"{at:.4g}" for at in test.profiles)
        words.append(f"profile{'s' if test.profiles[1:] else ''} at {at} s")
    return ", ".join(words)


def _spreads(design: DesignResult, one: Design) -> str:
    spreads = []
    pairs = zip(design.problem.parameters, design.nominal, one.sd, strict=True)
    for place, (parameter, value, sd) in enumerate(pairs):
        low, high = one.range[:, place]
        if not np.isfinite(sd):
            spreads.append(f"{parameter.key} not identified")
        elif parameter.log:
            spreads.append(f"{parameter.key} +- {100.0 * sd / value:.2g} %")
        else:
            spreads.append(
                f"{parameter.key} +- {sd:.2g}{unit_of_key(design.problem, parameter.key)}"
            )
        if np.isfinite(sd) and high > 1.5 * low:
            worst = f"{high / sd:.2g} times" if np.isfinite(high) else "not identified"
            spreads[-1] += f" (at worst {worst})"
    return "; ".join(spreads)


def save(design: DesignResult, folder: Path) -> None:
    """Write all three files; design.json, which says that it is whole, the last. On one rank.

    Raises
    ------
    InputError, ComputationError : the folder or the disk.
    """
    check(folder, FILES)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(folder, error) from error
    picture = io.BytesIO()  # drawing takes long: who is killed meanwhile leaves no file
    design.plot().savefig(picture, format="png", dpi=130)
    try:
        with atomic_write(folder / MAP) as path:
            path.write_bytes(picture.getbuffer())
        with atomic_write(folder / NEXT) as path:
            spreads = _spreads(design, design.designs[0])
            path.write_text(next_tests(design, spreads), encoding="utf-8")
        with atomic_write(folder / DESIGN) as path:
            path.write_text(json.dumps(design.to_dict(), indent=1, allow_nan=False) + "\n")
    except OSError as error:
        name = error.filename or folder
        raise ComputationError(f"{name}: {error.strerror or error}") from error
