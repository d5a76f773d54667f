"""``rw.predict`` and ``ringwear predict``: what a fit says of a case that was not tested."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, Output, Overrides, refuse_stop
from ringwear_par.cases.files.reading import read_case
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.identification.definition.problem import Experiment
from ringwear_par.identification.fit_result import FitResult
from ringwear_par.identification.model.histories import cases_at, step_times
from ringwear_par.parallel import on_first_rank
from ringwear_par.prediction.draws import draw_paces, draw_values
from ringwear_par.prediction.folder import files_line, prepare
from ringwear_par.prediction.known import (
    FitKnowledge,
    check_predicted,
    doubts_of,
    fit_knowledge,
    sources_of,
)
from ringwear_par.prediction.prediction import QUANTITIES, Prediction, read_depth
from ringwear_par.results.result import Result
from ringwear_par.studies.execution.many import results_of

#: equal steps besides those of fits: noise is interpolated within a step
_EVEN = 50
#: share of such a step by which ends of other steps must be away from its ends
_NEAR = 0.2
#: largest share of the draws that may fail
_MOST_FAILED = 0.1

Source = FitResult | Path | str


@dataclass(frozen=True, eq=False)
class _Job:
    """What all ranks compute: a case at values (draws, m) of the fit's keys."""

    known: FitKnowledge
    case: Case
    of: str
    seed: int
    points: FloatArray
    sizes: FloatArray


def predict(
    fit: Source,
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
    InputError : the folder, the case, keys of the fit that it does not have, or a fit that does not
        know all of them.
    ComputationError : the histories.
    """
    comm = MPI.COMM_WORLD if comm is None else comm
    job = on_first_rank(comm, lambda: _job(fit, case, (), of, draws, seed))
    return _predicted(job, comm)


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

    def read() -> tuple[_Job, float | None]:
        faults: list[str] = []
        mm = None if depth is None else read_depth(depth, faults)
        if faults:
            raise InputError(*faults)
        job = _job(fit, case, overrides, of, draws, seed, "--")
        prepare(folder)
        return job, mm

    job, mm = on_first_rank(comm, read)
    result = replace(_predicted(job, comm), depth=mm)
    on_first_rank(comm, lambda: result.save(folder))
    if comm.rank == 0:
        print(result.summary())
        print(files_line(folder))


def _job(
    fit: Source,
    case: Case | Path | str | Mapping[str, Any],
    overrides: Overrides,
    of: str,
    draws: int,
    seed: int,
    dashes: str = "",
) -> _Job:
    """Return the job of all ranks, with its draws; ``dashes`` of the command's. On one rank."""
    for name, number, least in (("draws", draws, 1), ("seed", seed, 0)):
        if isinstance(number, bool) or not isinstance(number, int) or number < least:
            raise InputError(f"{dashes}{name} = {number!r}: must be a whole number >= {least}")
    known = fit_knowledge(fit)
    name = str(case) if isinstance(case, Path | str) else "case"
    case = case if isinstance(case, Case) else read_case(case, overrides)
    refuse_stop(case, name, "in a prediction")
    check_predicted(known, case, name, of, dashes)
    random = np.random.default_rng(seed)
    return _Job(known, case, of, seed, *draw_values(known.values, of, draws, random))


def _predicted(job: _Job, comm: MPI.Comm) -> Prediction:
    """Return the prediction of a job. Collective on comm."""
    case, keys, ends = job.case, job.known.values.keys, _step_ends(job.case)
    output = Output(profiles="last", fields=("pressure",))
    failures: dict[int, Exception] = {}
    cases: dict[int, Case] = {}
    for draw, at_values in enumerate(cases_at(case, keys, job.points)):
        if isinstance(at_values, Case):
            cases[draw] = replace(at_values, output=output, stress=None)
        else:
            failures[draw] = at_values

    def compute(paces: Mapping[int, FloatArray] | None) -> dict[int, Result]:
        left = [draw for draw in cases if draw not in failures]
        left_paces = None if paces is None else [paces[draw] for draw in left]
        outcomes = results_of([cases[d] for d in left], comm, step_times=ends, paces=left_paces)
        results = {}
        for draw, outcome in zip(left, outcomes, strict=True):
            if isinstance(outcome, Result):
                results[draw] = outcome
            else:
                failures[draw] = outcome.error
        return results

    results = compute(None)
    if job.sizes.any() and results:
        depths = {
            draw: np.stack([r.histories[f"worn_volume_{b}"][1:] for b in ("lower", "upper")])
            / case.area
            for draw, r in results.items()
        }
        random = np.random.default_rng([job.seed, 1])
        drawn = draw_paces(np.stack([*depths.values()]), job.sizes[:, [*depths]], random)
        results = compute(dict(zip(depths, drawn, strict=True)))
    if len(failures) > _MOST_FAILED * len(job.points):
        raise ComputationError(
            f"{len(failures)} of {len(job.points)} draws have no history: {failures[min(failures)]}"
        )
    left, known = sorted(results), job.known
    return Prediction(
        job.of, known.name, case.stored_text, job.seed, known.units, job.points[left],
        job.sizes[:, left], results[left[0]].histories["time"],
        {name: np.stack([results[d].histories[name] for d in left]) for name in QUANTITIES},
        len(failures), sources_of(known, job.of, job.sizes), doubts_of(known, case, job.of),
    )  # fmt: skip


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
