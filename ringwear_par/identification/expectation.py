"""The dry run of a fit: what its readings would tell if the parameters had their starts."""

from dataclasses import replace

import numpy as np
from mpi4py import MPI
from scipy.stats import norm

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError, counted, warning_lines
from ringwear_par.identification.definition.fitted_parameters import unit_of_key, unit_scale
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.design.information import before_tests, informations
from ringwear_par.identification.doubts import of_units
from ringwear_par.identification.histories import Readings
from ringwear_par.identification.key_estimates import VAGUE, direction, prior_sd
from ringwear_par.identification.record_checks import refuse_unfit
from ringwear_par.identification.summary import KeyRow
from ringwear_par.results.progress import StopSignals


def expectation(problem: Problem, comm: MPI.Intracomm) -> str:
    """Return what to expect of a fit, in lines. Collective on comm."""
    with StopSignals() as signals:
        readings = Readings(problem, comm, signals)
        covariance = readings.lead(lambda: _covariance(readings))
    return _in_words(problem, covariance)


def _covariance(readings: Readings) -> FloatArray:
    """Return the covariance (m, m) of the unknowns that readings and priors leave, linear."""
    refuse_unfit(readings)
    problem = readings.problem
    start = problem.unknowns([*problem.start.values()])
    before = replace(before_tests(problem, None), draws=start[None])
    # tests of one specimen too are taken as if of several
    every = informations(readings, before)[:, 0]
    if not np.isfinite(every).all():
        raise ComputationError(f"{problem.name}: no history at the start: {readings.reason}")
    priors = np.diag([prior_sd(parameter) ** -2 for parameter in problem.parameters])
    return np.linalg.inv(priors + every.sum(axis=0))


def _in_words(problem: Problem, covariance: FloatArray) -> str:
    level = problem.settings.level
    reach = float(norm.ppf(0.5 + 0.5 * level))
    n = sum(test.n for test in problem.experiments)
    lines = [
        f"{problem.name}: {counted(n, 'reading')} in "
        f"{counted(len(problem.experiments), 'experiment')}; to be expected if the parameters have "
        "their start values (nothing written):",
        *warning_lines(doubt.text for doubt in of_units(problem.experiments)),
    ]
    width, bounds = max(map(len, problem.keys)), np.array(problem.unknown_bounds)
    for j, parameter in enumerate(problem.parameters):
        sd, scale = float(np.sqrt(covariance[j, j])), unit_scale(parameter)
        unit = parameter.unit or unit_of_key(problem, parameter.key).strip()
        at, (low, high) = parameter.unknown(parameter.start), bounds[:, j]
        ends = [at - reach * sd, at + reach * sd]
        interval = [parameter.value(end) / scale if low < end < high else None for end in ends]
        row = KeyRow(parameter.key, parameter.start / scale, sd, unit, interval)
        words = f"{row.ends} ({100 * level:g} %)"
        if sd > VAGUE * prior_sd(parameter):
            words = f"would not be identified: {direction(problem, covariance, j, {})}"
        of = " of the material" * (parameter.scatter is not None)
        lines.append(f"  {row.label.ljust(width)}  {row.value}{of}  {words}")
    if taken := [
        p.key for p in problem.parameters if p.scatter and None in p.scatter.sizes.values()
    ]:
        lines.append(
            f"  the scatter of {', '.join(taken)} is taken as known; a fit of few specimens, which "
            "has to find it, has wider intervals"
        )
    if problem.alternatives:
        lines.append(f"to be compared: {', '.join(problem.alternatives)}")
    return "\n".join(lines)
