"""Checks of single records: readings that cannot be what they are called, or oppose the model."""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.stats import f as f_distribution

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.errors import InputError, ValidityWarning, legible
from ringwear_par.files.smoothing import MOST_POINTS
from ringwear_par.identification.definition.problem import (
    GROWTH_TIME,
    Experiment,
    Nuisance,
    Series,
)
from ringwear_par.identification.definition.reading_kinds import READING_KINDS
from ringwear_par.identification.estimation.misfit import Evaluation, Misfit
from ringwear_par.identification.estimation.starts import case_points
from ringwear_par.identification.model.histories import HistoryError
from ringwear_par.identification.model.noise import NuisanceProjection
from ringwear_par.identification.model.readings import growth, nuisance_columns

#: number of blocks of a record, and fewest readings, less nuisances, that it needs
_BLOCKS, _ENOUGH = 10, 30
#: probability that blocks of mere noise differ as much: below it they are none
_NO_NOISE = 1e-4
#: share of an input: smaller noise is not searched for trends
_EXACT = 1e-3
#: share of the noise of all readings: a smaller change over the whole of all bounds is no response
_NO_RESPONSE = 1e-6
#: readings do not depend on a key if they change by less than this share of their noise over a
#: factor of e of it, where its logarithm is fitted, else over ten times the width of its bounds
_NOT_FELT, _WIDTHS = 0.5, 10.0
#: fewest points at which responses are computed
_POINTS = 8
#: correlation of readings with the model below which they have the wrong sign, and at how many sd
_OPPOSITE, _SURE = -0.5, 5.0
#: nuisances that leave the sign of a record as it is
_HARMLESS = ("offset", "level", "tilt", "thermal")
#: time constants of growth below which a record cannot distinguish growth from drift
_ALIKE = 3.0
#: parts of a record at its ends that are compared with the model's sign grow by 1 / this of it
_PARTS = 40


def record_warnings(
    misfit: Misfit, x: FloatArray, evaluation: Evaluation
) -> tuple[ValidityWarning, ...]:
    """Return warnings about single records of a fit, whose unknowns are x at the optimum."""
    return (
        *_oppositions(misfit, evaluation.model - misfit.nuisance_readings(x)),
        *_trends(misfit, evaluation),
        *input_trends(misfit.problem.experiments),
        *_alike(misfit, x),
    )


def _oppositions(misfit: Misfit, model: FloatArray) -> Iterator[ValidityWarning]:
    """Yield warnings about records that fall where the model's, without nuisances, rise."""
    for experiment, series, rows in misfit.records:
        record = _Record(experiment, series, misfit.sd[rows], model[rows])
        if not READING_KINDS[series.kind].of_wear or series.profile or not record.opposes():
            continue
        kinds = " and ".join(n.kind for n in series.nuisances if n.kind != GROWTH_TIME)
        beside = f"apart from {kinds}, " if kinds else ""
        place = f"{series.name} ({experiment.name}): {beside}readings fall where the model rises"
        exclude = record.exclude
        if exclude is None:
            place += "; check their sign and the record of the test"
        else:
            first, last = exclude
            place += (
                f", because of the readings from {first:.10g} to {last:.10g} s; if these show "
                "something else than wear, leave them out: "
                f"exclude = [[{first:.10g}, {last:.10g}]]"
            )
        values = {"series": series.name, "exclude": exclude and list(exclude)}
        yield ValidityWarning("readings-oppose", place, (), (experiment.name,), values)


def _trends(misfit: Misfit, evaluation: Evaluation) -> Iterator[ValidityWarning]:
    """Yield warnings about records whose residuals are no noise."""
    for experiment, series, rows in misfit.records:
        values = misfit.censored[rows] == 0
        if series.profile:
            continue
        residuals = -evaluation.noise[rows][values]
        # noise that is given is no smaller than that
        least = 0.0 if series.sd_fitted else 1.0
        probability = trend(residuals, len(series.nuisances), least)
        if probability >= _NO_NOISE:
            continue
        differences = "the differences are not noise with the given sd"
        place = (
            f"readings of {experiment.name}, {series.name}, trend away from the model "
            f"(p = {probability:.1g}): "
            f"{'the fitted sd is not noise alone' if series.sd_fitted else differences}; intervals "
            f"are too "
            "narrow"
        )
        values = {"series": series.name, "p": probability}
        yield ValidityWarning("residuals-trend", place, (), (experiment.name,), values)


def input_trends(experiments: Sequence[Experiment]) -> list[ValidityWarning]:
    """Return warnings about measured inputs whose curves do not follow their readings."""
    warnings = []
    for experiment in experiments:
        for measured in experiment.inputs:
            if measured.smooth == "none":
                continue
            value = measured.readings(experiment.case)
            least = (_EXACT * float(value.mean())) ** 2
            probability = trend(value - measured.curve(experiment.case)(measured.time), least=least)
            if probability >= _NO_NOISE:
                continue
            text = (
                f"readings of {measured.key} ({experiment.name}) trend away from their curve (p = "
                f"{probability:.1g}), which is too smooth for a jump or a fast change; smooth must "
                f'be a shorter time, or "none" (at most {MOST_POINTS} readings)'
            )
            values = {"input": measured.key, "p": probability}
            warnings.append(ValidityWarning("input-trend", text, (), (experiment.name,), values))
    return warnings


def _alike(misfit: Misfit, x: FloatArray) -> Iterator[ValidityWarning]:
    """Yield warnings about records that do not tell a drift from thermal growth."""
    for experiment, series, _ in misfit.records:
        no_prior = {n.kind for n in series.nuisances if n.prior is None}
        if not {"drift", "thermal"} <= no_prior:
            continue
        time = float(x[misfit.names.index((experiment.name, series.name, GROWTH_TIME))])
        last = float(series.x.max())
        if last < _ALIKE * time:
            place = (
                f"{series.name} ({experiment.name}): readings until {last:.4g} s hardly tell a "
                f"drift from thermal growth with a time constant of {time:.4g} s; give one a prior"
            )
            values = {"series": series.name, "time": time, "last": last}
            yield ValidityWarning("drift-or-growth", place, (), (experiment.name,), values)


def trend(residuals: FloatArray, n_nuisances: int = 0, least: float = 0.0) -> float:
    """Return how probable residuals (n,) in time are if they are noise, 1 for too few to tell.

    Sums of blocks are compared with differences of neighbours, which trends hardly change; the
    variance is at least ``least``.
    """
    n = len(residuals)
    if n - n_nuisances < _ENOUGH:
        return 1.0
    noise = max(0.5 * float(np.mean(np.diff(residuals) ** 2)), least)
    if not noise:
        return 1.0
    blocks = np.array_split(residuals, _BLOCKS)
    between = sum(float(block.sum()) ** 2 / len(block) for block in blocks)
    freedom = max(_BLOCKS - n_nuisances, 1)
    # degrees of freedom of the mean square of successive differences of white noise
    noise_freedom = 2.0 * (n - 1) ** 2 / (3 * n - 4)
    return float(f_distribution.sf(between / (freedom * noise), freedom, noise_freedom))


def refuse_idle(misfit: Misfit, start: FloatArray) -> None:
    """Refuse series that respond to no parameter, and keys without response. Not collective."""
    m = len(misfit.problem.parameters)
    columns = misfit.evaluate(start).noise_jacobian[:, :m] * (misfit.upper - misfit.lower)[:m]
    faults = [
        f'{misfit.problem.name}: experiment "{legible(experiment.name)}": {series.name}: does not '
        f"respond to any parameter at the start ({_start_values(misfit)}); must respond to at "
        f"least "
        "one"
        for experiment, series, part in misfit.records
        if np.linalg.norm(columns[part]) < _NO_RESPONSE and not misfit.censored[part].all()
    ]
    faults += [
        f"{misfit.problem.name}: no readings respond to {parameter.key}, at the start "
        f"({_start_values(misfit)}) or anywhere within its bounds; some must: is a threshold "
        "(p0) above all pressures?"
        for parameter, responding in zip(
            misfit.problem.parameters, _responding(misfit, start), strict=True
        )
        if not responding and parameter.prior is None
    ]
    if faults:
        raise InputError(*faults)


def _responding(misfit: Misfit, start: FloatArray) -> BoolArray:
    """Return which parameters (m,) change some readings at any start, in ways nuisances do not.

    At the edges of a contact pressures exceed all thresholds, so that something always responds.
    """
    problem, m = misfit.problem, len(misfit.problem.parameters)
    widths = (misfit.upper - misfit.lower)[:m]
    reach = np.where([parameter.log for parameter in problem.parameters], 1.0, _WIDTHS * widths)

    def at(x: FloatArray) -> BoolArray:
        try:
            prior_rows = misfit.evaluate(x).jacobian[misfit.n :]
        except HistoryError:
            return np.ones(m, dtype=bool)
        # limits that hold by far respond, but their likelihood does not
        rows = np.concatenate([misfit.whitened(misfit.columns(x)), prior_rows])
        columns, nuisances = rows[:, :m], rows[:, m:]
        columns = NuisanceProjection(nuisances).rest(columns)
        return np.linalg.norm(columns[: misfit.n], axis=0) * reach > _NOT_FELT

    responding = at(start)
    if responding.all():
        return responding
    most = max(_POINTS, problem.settings.starts)
    points = [np.concatenate([row, start[m:]]) for row in case_points(misfit, most)]
    misfit.responses.compute(points)
    responding = np.logical_or.reduce([responding, *map(at, points)])
    misfit.responses.forget(points, start)
    return responding


def _start_values(misfit: Misfit) -> str:
    return ", ".join(f"{key} = {value:g}" for key, value in misfit.problem.start.items())


def refuse_reversed(misfit: Misfit, start: FloatArray) -> None:
    """Refuse depths and masses that go against the model, but for their nuisances. Not collective.

    Those that do so only once a drift or a compliance is fitted too may be right but for a part,
    of which a warning at the optimum tells; so may records that change as the model in total.
    """
    model = misfit.model_readings(start)
    faults = []
    for experiment, series, part in misfit.records:
        record = _Record(experiment, series, misfit.sd[part], model[part])
        if not READING_KINDS[series.kind].of_wear or record.follows:
            continue
        if record.opposes() and record.opposes(harmless=True):
            faults.append(
                f'{misfit.problem.name}: experiment "{legible(experiment.name)}": {series.name}: '
                "has the wrong sign: readings fall where the model rises; must be positive where "
                "material is lost"
            )
    if faults:
        raise InputError(*faults)


class _Record:
    """Readings (n,) of a series and the model's without nuisances, over their noise."""

    def __init__(
        self, experiment: Experiment, series: Series, sd: FloatArray, model: FloatArray
    ) -> None:
        self._series = series
        columns, self._nuisances = [], []
        series_columns = nuisance_columns(series, experiment.case).T
        for nuisance, column in zip(series.nuisances, series_columns, strict=True):
            if nuisance.kind == GROWTH_TIME:  # growth with any of some time constants
                low, high = nuisance.bounds
                for time in (nuisance.start, low, 0.5 * (low + high), high):
                    grown = growth(nuisance, experiment.case, series.x, time)[0]
                    columns.append(series.factor * grown)
                    self._nuisances.append(Nuisance("thermal"))
            elif nuisance.kind != "thermal":
                columns.append(column)
                self._nuisances.append(nuisance)
        self._columns = np.array(columns).reshape(-1, series.n).T / sd[:, None]
        self._both = np.stack([series.value, model], axis=1) / sd[:, None]

    def opposes(self, rows: slice = slice(None), *, harmless: bool = False) -> bool:
        """Tell whether readings fall where the model's rise, whatever the (harmless) nuisances."""
        numbers = [i for i, n in enumerate(self._nuisances) if not harmless or n.kind in _HARMLESS]
        columns, both = self._columns[rows, numbers], self._both[rows]
        for column, i in enumerate(numbers):  # priors are one reading more, of the nuisance itself
            prior = self._nuisances[i].prior
            if prior is not None:
                columns = np.vstack([columns, np.eye(len(numbers))[column] / prior.sd])
                both = np.vstack([both, [prior.mean / prior.sd, 0.0]])
        both = NuisanceProjection(columns).rest(both)
        (data, wear), sizes = both.T, np.linalg.norm(both, axis=0)
        return bool(data @ wear < _OPPOSITE * sizes.prod() and -data @ wear > _SURE * sizes[1])

    @property
    def follows(self) -> bool:
        """Whether readings in time change as the model does, in total."""
        data, wear = self._both[-1] - self._both[0]
        return not self._series.profile and data * wear > 0.0

    @property
    def exclude(self) -> tuple[float, float] | None:
        """The shortest early or late part, s, without which readings do not oppose the model."""
        x, n = self._series.x, self._series.n
        for count in np.unique(np.arange(1, _PARTS // 2 + 1) * n // _PARTS).tolist():
            if count and not self.opposes(slice(count, None)):
                return 0.0, float(x[count - 1])
            if count and not self.opposes(slice(0, n - count)):
                return float(x[n - count]), float(x[-1])
        return None
