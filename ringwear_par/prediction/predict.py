"""``rw.predict`` and ``ringwear predict``: what a fit says of a case that was not tested."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, Output, Overrides, refuse_stop
from ringwear_par.cases.files.reading import read_case
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import ComputationError, InputError, counted
from ringwear_par.files.folders import PREDICTION, check_folder
from ringwear_par.files.writing import announce_replacement, closing_line
from ringwear_par.identification.definition.problem import Experiment
from ringwear_par.identification.draws import NEXT, Draws
from ringwear_par.identification.histories import cases_at, step_times
from ringwear_par.parallel import on_first_rank
from ringwear_par.prediction.known import check_predicted, doubts_of, fit_knowledge
from ringwear_par.prediction.prediction import FILES, QUANTITIES, Prediction, read_depth
from ringwear_par.results.result import Result
from ringwear_par.studies.many import results_of

if TYPE_CHECKING:
    from ringwear_par.identification.fit_result import FitResult

#: equal steps besides those of fits: noise is interpolated within a step
_EVEN = 50
#: share of such a step by which ends of other steps must be away from its ends
_NEAR = 0.2
#: largest share of the draws that may fail
_MOST_FAILED = 0.1
#: mean wear of a step over the size of the noise below which a step wears nothing, or almost never
_LEAST_SHAPE = 1e-12


def predict(
    fit: "FitResult | Path | str",
    case: Case | Path | str | Mapping[str, Any],
    *,
    of: str = "next specimen",
    draws: int = 1000,
    seed: int = 0,
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

    Returns
    -------
    Prediction : bands of the histories, ``.summary()``, ``.save(folder)``.

    Raises
    ------
    InputError : the folder, the case, or keys and laws of the fit that it does not have.
    ComputationError : the histories.
    """
    comm = MPI.COMM_WORLD if comm is None else comm
    drawn = on_first_rank(comm, lambda: _drawn(fit, case, (), of, draws, seed))
    return _predicted(*drawn, comm)


def run_predict(
    fit: Path,
    case: Path,
    folder: Path,
    comm: MPI.Intracomm,
    *,
    overrides: Sequence[str] = (),
    of: str = "next specimen",
    draws: int = 1000,
    seed: int = 0,
    depth: str | None = None,
) -> None:
    """Predict and write the outcome to a folder. Collective on comm.

    Parameters
    ----------
    depth : of penetration with its unit, whose time is told.
    """

    def read() -> tuple[Case, Prediction]:
        faults: list[str] = []
        mm = None if depth is None else read_depth(depth, faults)
        if faults:
            raise InputError(*faults)
        whole, drawn = _drawn(fit, case, overrides, of, draws, seed, "--")
        check_folder(folder, FILES, "predict")
        announce_replacement(folder / PREDICTION)
        return whole, replace(drawn, depth=mm)

    result = _predicted(*on_first_rank(comm, read), comm)
    on_first_rank(comm, lambda: result.save(folder))
    if comm.rank == 0:
        print(result.summary())
        print(closing_line(folder, FILES))


def _drawn(
    fit: "FitResult | Path | str",
    case: Case | Path | str | Mapping[str, Any],
    overrides: Overrides,
    of: str,
    count: int,
    seed: int,
    dashes: str = "",
) -> tuple[Case, Prediction]:
    """Return a case, and its prediction without histories; ``dashes`` of options. On one rank."""
    for name, number, least in (("draws", count, 1), ("seed", seed, 0)):
        if isinstance(number, bool) or not isinstance(number, int) or number < least:
            raise InputError(f"{dashes}{name} = {number!r}: must be a whole number >= {least}")
    known = fit_knowledge(fit)
    draws, name = known.draws, str(case) if isinstance(case, Path | str) else "case"
    case = case if isinstance(case, Case) else read_case(case, overrides)
    refuse_stop(case, name, "in a prediction")
    check_predicted(draws, case, name, of, dashes)
    unknowns, sizes = draws.unknowns(of, count, np.random.default_rng(seed))
    return case, Prediction(
        of, known.name, case.stored_text, seed, dict(zip(draws.keys, draws.units, strict=True)),
        draws.values(unknowns), sizes, (*_sources(draws, of, sizes),), doubts_of(known, case, of),
    )  # fmt: skip


def _sources(draws: Draws, of: str, sizes: FloatArray) -> Iterator[str]:
    """Yield sentences about what was drawn, with sizes (draws, 2) mm of the random wear."""
    yield f"posterior of the fit to {counted(len({*draws.specimens}), 'specimen')}"
    if draws.scatter and of == NEXT:
        yield f"scatter of {', '.join(dict.fromkeys(key for key, _ in draws.scatter))}"
    if sizes.any():
        yield f"wear at random, size {1e6 * np.median(sizes.max(axis=1)):.3g} nm"


def _predicted(case: Case, drawn: Prediction, comm: MPI.Comm) -> Prediction:
    """Return a prediction with its histories. Collective on comm."""
    ends, output = _step_ends(case), Output(profiles="last", fields=("pressure",))
    errors: list[Exception] = []
    cases: dict[int, Case] = {}
    for draw, at_values in enumerate(cases_at(case, [*drawn.keys], drawn.values)):
        if isinstance(at_values, Case):
            cases[draw] = replace(at_values, output=output, stress=None)
        else:
            errors.append(at_values)

    def compute(draws: Collection[int], paces: Sequence[FloatArray] | None) -> dict[int, Result]:
        outcomes = results_of([cases[d] for d in draws], comm, step_times=ends, paces=paces)
        errors.extend(outcome.error for outcome in outcomes if not isinstance(outcome, Result))
        return {d: r for d, r in zip(draws, outcomes, strict=True) if isinstance(r, Result)}

    results = compute(cases, None)
    if drawn.sizes.any() and results:
        volumes = np.stack(
            [[result.histories[f"worn_volume_{body}"][1:] for body in BODIES]
             for result in results.values()]
        )  # fmt: skip
        random = np.random.default_rng([drawn.seed, 1])
        paces = draw_paces(volumes / case.area, drawn.sizes[[*results]], random)
        results = compute(results, [*paces])
    count, left = len(drawn.values), [*results]
    if len(errors) > _MOST_FAILED * count:
        raise ComputationError(f"{len(errors)} of {count} draws have no history: {errors[0]}")
    return replace(
        drawn, values=drawn.values[left], sizes=drawn.sizes[left], failed=len(errors),
        time=results[left[0]].histories["time"],
        histories={q: np.stack([r.histories[q] for r in results.values()]) for q in QUANTITIES},
    )  # fmt: skip


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
    paces = np.ones_like(increments)
    noisy = shapes > _LEAST_SHAPE
    paces[noisy] = random.gamma(shapes[noisy]) / shapes[noisy]
    return paces


def _step_ends(case: Case) -> list[float]:
    """Return the ends of the steps of all draws, s: geometric after bends of schedules, then even.

    Fixed steps are those of the case.
    """
    end = case.time.end
    if not case.time.adaptive:
        return [*(case.time.step * np.arange(1, case.time.steps)).tolist(), end]
    ends = step_times(Experiment("", case, ()))
    even = end * np.arange(1, _EVEN) / _EVEN
    apart = np.abs(even[:, None] - ends).min(axis=1) > _NEAR * end / _EVEN
    return sorted([*ends.tolist(), *even[apart].tolist()])
