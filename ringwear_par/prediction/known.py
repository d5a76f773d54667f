"""What predictions take from a fit or its folder, what they refuse, what they doubt."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, get_args

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.values import is_finite
from ringwear_par.errors import InputError, ValidityWarning, counted, legible
from ringwear_par.files.folders import DESIGN, FIT, PROGRESS, READINGS
from ringwear_par.files.text import read_text
from ringwear_par.history.derivatives.keys import differentiable
from ringwear_par.identification.estimation.intervals import Verdict
from ringwear_par.identification.fit_result import FitResult
from ringwear_par.identification.fitted_values import (
    CONDITIONS,
    GROUP,
    LAWS,
    FittedValues,
    conditions_of,
    fitted_values,
    law_names,
    read_values,
)
from ringwear_par.prediction.draws import MATERIAL, NEXT
from ringwear_par.results.storage.hdf5 import reading
from ringwear_par.results.variables import SOFTWARE

#: relative difference below which conditions are the same
_SAME = 0.02
_A_FIT = "must be the folder of a fit that is done (ringwear fit -o)"


@dataclass(frozen=True, eq=False)
class FitKnowledge:
    """What a fit knows."""

    #: what messages call it
    name: str
    #: of its keys
    values: FittedValues
    #: of these, by key
    units: Mapping[str, str]
    #: by key
    verdicts: Mapping[str, str]
    #: how many it has
    warnings: int
    #: logarithm of its evidence, see ``log_evidence`` of fits; None: it is not known
    log_evidence: float | None
    #: the same of the laws that it was compared with, by name
    laws: "Mapping[str, FitKnowledge]" = field(default_factory=dict)

    @property
    def specimens(self) -> int:
        """Number of the specimens that were tested."""
        return len({*self.values.specimens})


def fit_knowledge(fit: FitResult | Path | str) -> FitKnowledge:
    """Return the knowledge of a fit, or of the fit of a folder. Not collective.

    Raises
    ------
    InputError : a folder of anything else, or of a fit that is not done.
    """
    if isinstance(fit, FitResult):
        laws = {law: fitted_values(other) for law, other in fit.alternatives.items()}
        return _knowledge("fit", fit.to_dict(), fitted_values(fit), laws)
    if not isinstance(fit, Path | str):
        raise InputError(
            f"fit: a fit or its folder is needed, not {type(fit).__name__}; rw.fit returns one"
        )
    folder = Path(fit)
    if not (folder / FIT).is_file():
        raise InputError(f"{legible(str(folder))}: {_fault(folder)}; {_A_FIT}")
    with reading(folder / READINGS, SOFTWARE, "the readings of ringwear fit") as file:
        if GROUP not in file:
            raise InputError(
                f"{folder / READINGS}: is of an earlier version, which did not store what "
                "predictions draw from; must be of a fit made again"
            )
        values = read_values(file)
        laws = {
            str(group.attrs["law"]): read_values(group) for group in file.get(LAWS, {}).values()
        }
    try:
        return _knowledge(str(folder), json.loads(read_text(folder / FIT)), values, laws)
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(f"{folder / FIT}: is not the outcome of a fit, or is damaged") from error


def _fault(folder: Path) -> str:
    """Return why a folder is not that of a fit."""
    if not folder.is_dir():
        return "is a file" if folder.exists() else "does not exist"
    if (folder / PROGRESS).is_dir():
        return "holds a fit that was interrupted (ringwear fit --restart completes it)"
    if (folder / DESIGN).exists():
        return "holds a design of tests, but no fit"
    return f"holds no {FIT}"


def _knowledge(
    name: str,
    outcome: Mapping[str, Any],
    values: FittedValues,
    laws: Mapping[str, FittedValues] = MappingProxyType({}),
) -> FitKnowledge:
    """Return the knowledge of an outcome and its values, and of the laws compared.

    Raises
    ------
    ValueError : they are of different fits, or an entry is not what fits write.
    """
    parameters, doubts = outcome["parameters"], outcome["doubts"]
    evidence = outcome.get("log_evidence")
    verdicts = {key: p["verdict"] for key, p in parameters.items()}
    units = {key: p["unit"] for key, p in parameters.items()}
    sound = (
        tuple(parameters) == values.keys
        and set(verdicts.values()) <= {*get_args(Verdict)}
        and all(isinstance(unit, str) for unit in units.values())
        and isinstance(doubts, list)
        and (evidence is None or is_finite(evidence))
    )
    if not sound:
        raise ValueError(name)
    return FitKnowledge(
        name, values, units, verdicts, len(doubts), evidence,
        {law: _knowledge(f"{name}, {law}", outcome["alternatives"][law], of_law)
         for law, of_law in laws.items()},
    )  # fmt: skip


def check_predicted(known: FitKnowledge, case: Case, name: str, of: str, dashes: str = "") -> None:
    """Refuse what a fit cannot predict.

    Parameters
    ----------
    name : what messages call the case.
    dashes : before the options of the command.

    Raises
    ------
    InputError : all faults.
    """
    values, faults = known.values, []
    if of not in (NEXT, MATERIAL, *values.specimens):
        names = ", ".join(f'"{legible(n)}"' for n in dict.fromkeys(values.specimens))
        faults.append(
            f'{dashes}of = "{legible(of)}": must be "{NEXT}", "{MATERIAL}" or one of {names}'
        )
    faults += [
        f"{known.name}: {key} is {verdict.replace('at', 'at its')}: there is no distribution to "
        "draw it from; must be identified, or set in the case and not fitted"
        for key, verdict in known.verdicts.items()
        if verdict != "identified"
    ]
    has_laws = law_names(case)
    other_laws = {f"{t}.": law for t, law in values.laws.items() if has_laws.get(t, "") != law}
    has = differentiable(case)
    for key in values.keys:
        table = next((table for table in other_laws if key.startswith(table)), None)
        if table is not None:
            law = has_laws.get(table[:-1], "")
            state = f'is "{law}"' if law else "is missing"
            law_keys = ", ".join(k for k in values.keys if k.startswith(table))
            faults.append(
                f'{name}: {table}law {state}: must be "{other_laws[table]}", of which the fit '
                f"found {law_keys}"
            )
        elif key not in has:
            faults.append(f"{name}: has no {key}, which the fit found; must have it")
    if faults:
        raise InputError(*dict.fromkeys(faults))


def sources_of(known: FitKnowledge, of: str, sizes: FloatArray) -> tuple[str, ...]:
    """Return sentences about what was drawn.

    Parameters
    ----------
    sizes : (2, draws) mm, of the process noise.
    """
    values, count = known.values, known.specimens
    tested = counted(count, "specimen")
    scatters = [values.keys[key] for key in dict.fromkeys(values.scattering.tolist())]
    if scatters:
        sentences = [f"scatter of {', '.join(scatters)} between {tested}"]
        if of == MATERIAL:
            sentences = [f"the material behind {tested}, without scatter"]
        elif of != NEXT:
            sentences = [f"specimen {legible(of)} in the light of {tested}"]
    else:
        how = "covariance" if values.samples is None else "posterior samples"
        if len(values.weights) > 1:
            how = "mixture over sizes of random wear"
        sentences = [f"{how} of the fit to {tested}"]
    if sizes.any():
        size = 1e6 * float(np.median(sizes.max(axis=0)))
        sentences.append(f"wear at random, size {size:.3g} nm")
    return tuple(sentences)


def doubts_of(known: FitKnowledge, case: Case, of: str) -> tuple[ValidityWarning, ...]:
    """Return the doubts about a prediction."""
    doubts = []
    values = known.values
    if of == NEXT and not len(values.scattering):
        text = (
            "the fit has no scatter: the next specimen differs more from those tested "
            '(scatter = "fit" where there are repeats)'
        )
        doubts.append(ValidityWarning("no-scatter", text))
    elif of != MATERIAL and not len(values.scattering):
        text = f"the fit has no scatter: {legible(of)} and its other specimens share one value"
        doubts.append(ValidityWarning("one-value", text))
    means = conditions_of(case, values.keys)
    for (name, unit), value, tests in zip(
        CONDITIONS.items(), means.tolist(), values.conditions.T, strict=True
    ):
        if np.isnan(value) or np.isnan(tests).all():
            continue
        low, high = float(np.nanmin(tests)), float(np.nanmax(tests))
        # a shorter test is a part of a longer one
        least = 0.0 if name == "distance" else low * (1.0 - _SAME)
        if not least <= value <= high * (1.0 + _SAME):
            symbol = f" {unit}" if unit != "1" else ""
            first, last = f"{low:.4g}", f"{high:.4g}"
            range_ = f"{first}{symbol}" if first == last else f"{first} to {last}{symbol}"
            text = f"extrapolates: {name} = {value:.4g}{symbol}, tests were at {range_}"
            numbers = {"condition": name, "case": value, "tests": [low, high], "unit": unit}
            doubts.append(ValidityWarning("extrapolates", text, values=numbers))
    if known.warnings:
        text = f"the fit itself has {counted(known.warnings, 'warning')}: read its summary first"
        doubts.append(ValidityWarning("fit-warnings", text))
    return tuple(doubts)
