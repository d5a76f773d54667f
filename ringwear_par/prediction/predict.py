"""``rw.predict`` and ``ringwear predict``: what a fit says of a case that was not tested.

Histories at draws of the fit, what is refused, and what is doubted; running tests start from these.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, Output, Overrides, refuse_stop
from ringwear_par.cases.files.reading import read_case
from ringwear_par.cases.smooth_keys import smooth_keys
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import ComputationError, InputError, ValidityWarning, legible
from ringwear_par.files.folders import POSTERIOR
from ringwear_par.identification.definition.problem import Experiment
from ringwear_par.identification.draws import (
    CONDITIONS,
    MATERIAL,
    NEXT,
    Draws,
    conditions_of,
    law_names,
    read_draws,
)
from ringwear_par.identification.fit import into_folder
from ringwear_par.identification.histories import cases_at, step_times
from ringwear_par.parallel import on_first_rank
from ringwear_par.prediction.prediction import FILES, QUANTITIES, Prediction
from ringwear_par.results.result import FailedResult, Result
from ringwear_par.studies.many import results_of

if TYPE_CHECKING:
    from ringwear_par.identification.fit_result import FitResult

#: equal steps besides those of fits: noise is interpolated within a step
_EVEN = 50
#: share of such a step by which ends of other steps must be away from its ends
_NEAR = 0.2
#: largest share of the draws that may fail
_MOST_FAILED = 0.1
#: relative difference below which conditions are the same
_SAME = 0.02


def predict(
    fit: "FitResult | Path | str",
    case: Case | Path | str | Mapping[str, Any],
    *,
    of: str = "next specimen",
    draws: int = 1000,
    seed: int = 0,
    overrides: Overrides = (),
    comm: MPI.Intracomm | None = None,
) -> Prediction:
    """Return histories of a case at draws of what a fit knows of its keys.

    Collective on comm, the world's where none is given; the same on all ranks, whatever their
    number.

    Parameters
    ----------
    fit : a fit, or its folder.
    case : in which the keys of the fit are drawn; or the name of its file, or its tables.
    of : "next specimen", with scatter and wear's own noise as far as the fit has them; "material",
        without; or the name of a specimen of the fit.
    draws : how many histories.
    seed : of the draws.
    overrides : of a case that is read, see ``rw.read_case``.

    Returns
    -------
    Prediction : bands of the histories, ``.summary()``, ``.save(folder)``.

    Raises
    ------
    InputError : the folder, the case, or keys and laws of the fit that it does not have.
    ComputationError : the histories.
    """
    comm = MPI.COMM_WORLD if comm is None else comm

    def read() -> tuple[Draws, Case]:
        for name, number, least in (("draws", draws, 1), ("seed", seed, 0)):
            if not isinstance(number, int) or number < least:
                raise InputError(f"{name} = {number!r}: must be a whole number >= {least}")
        known, name = fit_draws(fit), str(case) if isinstance(case, Path | str) else "case"
        whole = case if isinstance(case, Case) else read_case(case, overrides)
        refuse_stop(whole, name, "in a prediction")
        check_predicted(known, whole, name, of)
        return known, whole

    known, whole = on_first_rank(comm, read)
    values, sizes = known.values(of, draws, np.random.default_rng(seed))
    found = _histories(whole, known, values, sizes, seed, comm)
    errors = [one.error for one in found if isinstance(one, FailedResult)]
    if len(errors) > _MOST_FAILED * draws:
        raise ComputationError(f"{len(errors)} of {draws} draws have no history: {errors[0]}")
    histories = [one.histories for one in found if isinstance(one, Result)]
    # without scatter, a fit knows of no other specimens than its own
    whose = of if known.scatter else "the specimens tested"
    return Prediction(
        {"of": of, "whose": whose, "fit": str(fit) if isinstance(fit, Path | str) else "fit",
         "case": whole.stored_text, "seed": seed},
        dict(zip(known.keys, known.units, strict=True)),
        values[[isinstance(one, Result) for one in found]],
        doubts_of(known, whole, of), histories[0]["time"],
        {name: np.stack([of_draw[name] for of_draw in histories]) for name in QUANTITIES},
        failed=len(errors),
    )  # fmt: skip


def run_predict(
    fit: Path,
    case: Path,
    folder: Path,
    comm: MPI.Intracomm,
    *,
    depth: float | None = None,
    **how: Any,
) -> None:
    """Predict as ``predict`` does and write the outcome to a folder. Collective on comm.

    Parameters
    ----------
    depth : mm, of penetration, whose time is printed.
    """

    def compute() -> Prediction:
        return replace(predict(fit, case, comm=comm, **how), depth=depth)

    into_folder(folder, FILES, comm, compute, "predict")


def fit_draws(fit: "FitResult | Path | str") -> Draws:
    """Return the draws of a fit, or of the fit of a folder; InputError of anything else."""
    if isinstance(fit, Path | str):
        if Path(fit).is_file():
            raise InputError(f"{fit}: is a file; must be the folder of a fit")
        return read_draws(Path(fit, POSTERIOR))
    if not isinstance(draws := getattr(fit, "draws", None), Draws):
        raise InputError(f"fit: a fit or its folder is needed, not {type(fit).__name__}")
    return draws


def check_predicted(draws: Draws, case: Case, name: str, of: str) -> None:
    """Refuse a specimen that the fit did not test, and a case without its keys or laws.

    InputError of all faults; ``name`` is what they call the case.
    """
    faults, missing, laws, possible = [], [], law_names(case), smooth_keys(case)
    if of not in (NEXT, MATERIAL, *draws.specimens):
        names = ", ".join(f'"{legible(n)}"' for n in dict.fromkeys(draws.specimens))
        faults.append(f'of = "{legible(of)}": must be "{NEXT}", "{MATERIAL}" or one of {names}')
    for key in draws.keys:
        table = key.rpartition(".")[0]
        law = draws.laws.get(table, "")
        if laws.get(table, "") != law or key not in possible:
            missing.append(key + f' of the law "{law}"' * bool(law))
    if missing:
        faults.append(f"{name}: must have {', '.join(missing)}, as the fit")
    if faults:
        raise InputError(*faults)


def doubts_of(draws: Draws, case: Case, of: str) -> tuple[ValidityWarning, ...]:
    """Return the doubts about a prediction, which the draws alone cannot show."""
    doubts = []
    if not draws.scatter:
        text = (
            "the fit has no scatter: specimens differ more than this band "
            '(scatter = "fit" where there are repeats)'
        )
        doubts.append(ValidityWarning("no-scatter", text))
    # NaN of what the fit does not know, or the case does not have
    tests = (f.reduce(draws.conditions) for f in (np.fmin, np.fmax))
    rows = np.stack([conditions_of(case, draws.keys), *tests], axis=1).tolist()
    for (name, unit), (value, *ends) in zip(CONDITIONS.items(), rows, strict=True):
        # a shorter test is a part of a longer one
        least = 0.0 if name == "distance" else ends[0] * (1.0 - _SAME)
        if value < least or value > ends[1] * (1.0 + _SAME):
            symbol = f" {unit}" if unit != "1" else ""
            tested = " to ".join(dict.fromkeys(f"{end:.4g}" for end in ends))
            text = f"extrapolates: {name} = {value:.4g}{symbol}, tests were at {tested}{symbol}"
            entries = {"condition": name, "case": value, "tests": ends, "unit": unit}
            doubts.append(ValidityWarning("extrapolates", text, values=entries))
    return tuple(doubts)


def _histories(
    case: Case, known: Draws, values: FloatArray, sizes: FloatArray, seed: int, comm: MPI.Intracomm
) -> list[Result | FailedResult]:
    """Return the histories at draws of keys, and of sizes of random wear. Collective on comm."""
    steps, output = _step_ends(case), Output(profiles="last", fields=("pressure",))
    cases = [
        replace(drawn, output=output, stress=None) if isinstance(drawn, Case) else drawn
        for drawn in cases_at(case, known.keys, values)
    ]
    ends = [steps] * len(cases)
    found = results_of(cases, comm, step_times=ends)
    if not sizes.any():
        return found
    depths = np.zeros((len(cases), len(BODIES), len(steps)))
    for mean, result in zip(depths, found, strict=True):
        if isinstance(result, Result):
            mean[:] = [result.histories[f"worn_volume_{b}"][1:] / case.area for b in BODIES]
    paces = draw_paces(depths, sizes, np.random.default_rng([seed, 1]))
    return results_of(cases, comm, step_times=ends, paces=[*paces])


def draw_paces(depths: FloatArray, sizes: FloatArray, random: np.random.Generator) -> FloatArray:
    """Return factors on the rates of steps, (draws, 2, steps), of means 1.

    Worn depth becomes a gamma process: its increment over a mean increment dS has a mean dS and a
    variance size dS.

    Parameters
    ----------
    depths : (draws, 2, steps) float, mm, mean worn depths of lower and upper at the ends of steps.
    sizes : (draws, 2) float, mm; 0: no noise.
    """
    increments = np.diff(depths, axis=-1, prepend=0.0)
    sizes = np.broadcast_to(sizes[:, :, None], increments.shape)
    shapes = np.divide(increments, sizes, out=np.zeros_like(increments), where=sizes > 0.0)
    paces, noisy = np.ones_like(increments), shapes > 0.0
    paces[noisy] = random.gamma(shapes[noisy]) / shapes[noisy]
    return paces


def _step_ends(case: Case) -> list[float]:
    """Return the ends of the steps of all draws, s: geometric after bends of schedules, then even.

    Fixed steps are those of the case.
    """
    end = case.time.end
    if not case.time.adaptive:
        return [*(case.time.step * np.arange(1, case.time.steps)).tolist(), end]
    ends, even = step_times(Experiment("", case, ())), end * np.arange(1, _EVEN) / _EVEN
    apart = np.abs(even[:, None] - ends).min(axis=1) > _NEAR * end / _EVEN
    return np.union1d(ends, even[apart]).tolist()
