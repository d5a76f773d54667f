"""The dry run of a fit: what its readings would tell if the parameters had their starts."""

from collections import defaultdict

import numpy as np
from mpi4py import MPI
from scipy.stats import norm

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError, counted, warning_lines
from ringwear_par.identification.definition.fitted_parameters import unit_scale, units_of
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.design.information import information
from ringwear_par.identification.doubts import assumptions
from ringwear_par.identification.histories import Readings
from ringwear_par.identification.key_estimates import direction, prior_sd
from ringwear_par.identification.likelihood import Setting
from ringwear_par.identification.record_checks import refuse_unfit
from ringwear_par.identification.setting import settings_at
from ringwear_par.identification.summary import digits_of, limits, number
from ringwear_par.results.execution.stop_signals import StopSignals

#: share of the prior's sd above which a key would not be identified
_VAGUE = 0.5


def expectation(problem: Problem, comm: MPI.Intracomm) -> str:
    """Return what to expect of a fit, in lines. Collective on comm."""
    with StopSignals() as signals:
        readings = Readings(problem, comm, signals)
        covariance = readings.lead(lambda: _covariance(readings))
    return _in_words(problem, covariance)


def _covariance(readings: Readings) -> FloatArray:
    """Return the covariance (m, m) of the unknowns that readings and priors leave, linear."""
    refuse_unfit(readings)
    problem, loss = readings.problem, readings.problem.settings.loss
    start = np.tile(problem.unknowns([*problem.start.values()]), (len(problem.experiments), 1))
    processes = problem.settings.process.values()
    settings = [Setting.before(test, loss, len(processes)) for test in problem.experiments]
    expected = np.array([process.expected_share for process in processes])
    settings = settings_at(readings, settings, start, expected, first=True)
    _, slopes = readings.jacobians(start)
    variances = np.array([p.scatter.variance if p.scatter else 0.0 for p in problem.parameters])
    known = np.diag([prior_sd(p) ** -2 for p in problem.parameters])
    for test, setting, slope in zip(readings.problem.experiments, settings, slopes, strict=True):
        if not np.isfinite(slope).all():
            raise ComputationError(
                f"{problem.name}: test {test.name}: no history at the start: {readings.reason}"
            )
        shares = np.where(np.isnan(setting.shares), expected, setting.shares)
        every = range(len(test.series))
        # tests of one specimen too are taken as if of several
        known += information(test, every, setting, shares, slope[:, None], loss, variances)[0]
    return np.linalg.inv(known)


def _in_words(problem: Problem, covariance: FloatArray) -> str:
    level = problem.settings.level
    reach, units = float(norm.ppf(0.5 + 0.5 * level)), units_of(problem)
    n = sum(test.n for test in problem.experiments)
    lines = [
        f"{problem.name}: {counted(n, 'reading')} in "
        f"{counted(len(problem.experiments), 'experiment')}; to be expected if the parameters have "
        "their start values (nothing written):",
        *warning_lines(doubt.text for doubt in assumptions(problem.experiments)),
    ]
    width, bounds = max(map(len, problem.keys)), np.array(problem.unknown_bounds)
    for j, parameter in enumerate(problem.parameters):
        sd, scale = float(np.sqrt(covariance[j, j])), unit_scale(parameter)
        unit = parameter.unit or units[parameter.key]
        at = parameter.unknown(parameter.start)
        ends = [at - reach * sd, at + reach * sd]
        low, high = bounds[:, j]
        interval = [parameter.value(end) / scale if low < end < high else None for end in ends]
        text = f"{number(parameter.start / scale)} {'' if unit in ('1', '-') else unit}".rstrip()
        of = " of the material" * (parameter.scatter is not None)
        if sd > _VAGUE * prior_sd(parameter):
            words = f"would not be identified: {direction(problem, covariance, j)}"
        else:
            digits = digits_of(parameter.start / scale, interval)
            words = f"{limits(interval, digits)} ({100 * level:g} %)"
        lines.append(f"  {parameter.key.ljust(width)}  {text}{of}  {words}")
    scatters = [(p.key, p.scatter.sizes) for p in problem.parameters if p.scatter]
    if taken := [key for key, sizes in scatters if None in sizes.values()]:
        lines.append(
            f"  the scatter of {', '.join(taken)} is taken as known; a fit of few specimens, which "
            "has to find it, has wider intervals"
        )
    lines += _readings(problem)
    if problem.alternatives:
        lines.append(f"to be compared: {', '.join(problem.alternatives)}")
    return "\n".join(lines)


def _readings(problem: Problem) -> list[str]:
    """Return a line of each kind of readings: how many, of how many tests, and their noise."""
    kinds: dict[tuple[str, str, bool], list[tuple[str, int, float]]] = defaultdict(list)
    for test in problem.experiments:
        for series in test.series:
            spread = float(np.median(series.sd)) / series.factor
            kind = series.quantity, series.unit, series.sd_fitted
            kinds[kind].append((test.name, series.n, spread))
        for measured in test.inputs:
            kinds[f"{measured.key} as measured", measured.series.unit, False].append(
                (test.name, measured.series.n, 0.0)
            )
    lines = []
    for (name, unit, fitted), found in kinds.items():
        tests = len({test for test, _, _ in found})
        low, high = (of(spread for _, _, spread in found) for of in (min, max))
        noise = (
            f", noise {low:.3g}" + f" to {high:.3g}" * (f"{high:.3g}" != f"{low:.3g}") + f" {unit}"
        )
        text = f"  {name}: {counted(sum(n for _, n, _ in found), 'reading')} of "
        lines.append(
            text + counted(tests, "test") + noise * (high > 0.0) + " (to be fitted)" * fitted
        )
    return lines
