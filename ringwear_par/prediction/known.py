"""What predictions and running tests read of a fit, what they refuse, and what they doubt."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.errors import InputError, ValidityWarning, counted, legible
from ringwear_par.files.folders import FIT
from ringwear_par.files.text import read_text
from ringwear_par.history.smooth_keys import smooth_keys
from ringwear_par.identification.draws import (
    CONDITIONS,
    MATERIAL,
    NEXT,
    Draws,
    conditions_of,
    draws_file,
    law_names,
    read_draws,
)

if TYPE_CHECKING:
    from ringwear_par.identification.fit_result import FitResult

#: relative difference below which conditions are the same
_SAME = 0.02


class FitKnowledge(NamedTuple):
    """What a fit knows, and how many warnings it has."""

    #: what messages call it
    name: str
    draws: Draws
    warnings: int
    #: draws of the laws that it was compared with, by name
    laws: Mapping[str, Draws]


def fit_knowledge(fit: "FitResult | Path | str") -> FitKnowledge:
    """Return the knowledge of a fit, or of the fit of a folder. Not collective.

    Raises
    ------
    InputError : anything else, or a folder without a whole fit.
    """
    if not isinstance(fit, Path | str):
        if not isinstance(draws := getattr(fit, "draws", None), Draws):
            raise InputError(
                f"fit: a fit or its folder is needed, not {type(fit).__name__}; rw.fit returns one"
            )
        laws = {law: other.draws for law, other in fit.alternatives.items()}
        return FitKnowledge("fit", draws, len(fit.doubts), laws)
    folder, path = Path(fit), Path(fit, FIT)
    if not path.is_file():
        state = f"holds no {FIT}" if folder.is_dir() else "is not a folder"
        raise InputError(f"{folder}: {state}; must be the folder of a fit (ringwear fit -o)")
    draws = read_draws(folder / draws_file(0))
    try:
        outcome = json.loads(read_text(path))
        if (*outcome["parameters"],) != draws.keys:
            raise ValueError("of another fit")
        warnings = len(outcome["warnings"])
        names = [law for law, entry in outcome["alternatives"].items() if "error" not in entry]
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(f"{path}: is not the outcome of a fit, or is damaged") from error
    laws = {law: read_draws(folder / draws_file(i)) for i, law in enumerate(names, start=1)}
    return FitKnowledge(str(folder), draws, warnings, laws)


def check_predicted(draws: Draws, case: Case, name: str, of: str, dashes: str = "") -> None:
    """Refuse a specimen that the fit did not test, and a case without its keys or laws.

    Parameters
    ----------
    name : what messages call the case.
    dashes : before the options of the command.

    Raises
    ------
    InputError : all faults.
    """
    faults = []
    if of not in (NEXT, MATERIAL, *draws.specimens):
        names = ", ".join(f'"{legible(n)}"' for n in dict.fromkeys(draws.specimens))
        faults.append(
            f'{dashes}of = "{legible(of)}": must be "{NEXT}", "{MATERIAL}" or one of {names}'
        )
    laws, missing = law_names(case), {*draws.keys} - smooth_keys(case).keys()
    for table, law in draws.laws.items():
        keys = [key for key in draws.keys if key.startswith(f"{table}.")]
        if keys and laws.get(table, "") != law:
            found = ", ".join(keys)
            state = f'is "{laws[table]}"' if laws.get(table) else "is missing"
            faults.append(
                f'{name}: {table}.law {state}: must be "{law}", of which the fit found {found}'
            )
            missing.difference_update(keys)
    faults += [f"{name}: has no {key}, which the fit found; must have it"
               for key in draws.keys if key in missing]  # fmt: skip
    if faults:
        raise InputError(*faults)


def doubts_of(known: FitKnowledge, case: Case, of: str) -> tuple[ValidityWarning, ...]:
    """Return the doubts about a prediction."""
    draws, doubts = known.draws, []
    if of != MATERIAL and not draws.scatter:
        text = (
            "the fit has no scatter: specimens differ more than this band "
            '(scatter = "fit" where there are repeats)'
        )
        doubts.append(ValidityWarning("no-scatter", text))
    means = conditions_of(case, draws.keys).tolist()
    for (name, unit), value, tests in zip(
        CONDITIONS.items(), means, draws.conditions.T, strict=True
    ):
        if np.isnan(value) or np.isnan(tests).all():
            continue
        low, high = float(np.nanmin(tests)), float(np.nanmax(tests))
        # a shorter test is a part of a longer one
        least = 0.0 if name == "distance" else low * (1.0 - _SAME)
        if not least <= value <= high * (1.0 + _SAME):
            symbol = f" {unit}" if unit != "1" else ""
            tested = " to ".join(dict.fromkeys((f"{low:.4g}", f"{high:.4g}")))
            text = f"extrapolates: {name} = {value:.4g}{symbol}, tests were at {tested}{symbol}"
            numbers = {"condition": name, "case": value, "tests": [low, high], "unit": unit}
            doubts.append(ValidityWarning("extrapolates", text, values=numbers))
    if known.warnings:
        text = f"the fit itself has {counted(known.warnings, 'warning')}: read its summary first"
        doubts.append(ValidityWarning("fit-warnings", text))
    return tuple(doubts)
