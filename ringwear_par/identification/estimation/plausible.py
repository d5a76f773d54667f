"""Readings that cannot be what they are called, as histories tell."""

from typing import NamedTuple

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.errors import ComputationError, InputError, legible
from ringwear_par.identification.definition.problem import Experiment, Series
from ringwear_par.identification.estimation.least_squares import LeastSquares
from ringwear_par.identification.estimation.starts import points
from ringwear_par.identification.model.readings import nuisance_columns

#: of the noise of all its readings: less is no response, over the whole of all bounds
_NO_RESPONSE = 1e-6
#: of the noise of all readings: a key by which they change less is not felt, over a factor of e
#: where its logarithm is sought, else over ten times the whole of its bounds
_NOT_FELT, _WIDTHS = 0.5, 10.0
#: points that are asked at least
_ASKED = 8
#: correlation of readings with the model below which they have the wrong sign, and at how many sd
_OPPOSITE, _SURE = -0.5, 5.0
#: nuisances that leave the sign of a record as it is
_HARMLESS = ("offset", "level", "tilt")
#: parts of a record that are looked at for what opposes the model, each larger by a share of it
_PARTS = 40


def refuse_idle(squares: LeastSquares, start: FloatArray) -> None:
    """Refuse quantities that respond to no parameter, and parameters without response.

    Not collective.

    Raises
    ------
    InputError : one sentence a series and a parameter.
    """
    m = len(squares.problem.parameters)
    columns = squares.evaluate(start).noise_jacobian[:, :m] * (squares.upper - squares.lower)[:m]
    faults = [
        f'{squares.problem.name}: experiment "{legible(experiment.name)}": {series.name}: does not '
        f"respond to any parameter at its start ({_values(squares)}); must respond to one at least"
        for (experiment, series), part in zip(squares.series, squares.parts, strict=True)
        if np.linalg.norm(columns[part]) < _NO_RESPONSE
    ]
    faults += [
        f"{squares.problem.name}: nothing that was read responds to {parameter.key}, at the start "
        f"({_values(squares)}) and anywhere within its bounds; must respond: is a threshold (p0) "
        "above all pressures?"
        for parameter, felt in zip(squares.problem.parameters, _felt(squares, start), strict=True)
        if not felt and parameter.prior is None
    ]
    if faults:
        raise InputError(*faults)


def _felt(squares: LeastSquares, start: FloatArray) -> BoolArray:
    """Return which parameters (m,) some readings respond to at any start, beside their nuisances.

    At the edges of a contact pressures exceed all thresholds, so that something always responds.
    """
    problem, m = squares.problem, len(squares.problem.parameters)
    widths = (squares.upper - squares.lower)[:m]
    reach = np.where([parameter.log for parameter in problem.parameters], 1.0, _WIDTHS * widths)

    def at(x: FloatArray) -> BoolArray:
        try:
            found = squares.evaluate(x)
        except ComputationError:
            return np.ones(m, dtype=bool)
        rows = np.concatenate([found.noise_jacobian, found.jacobian[squares.n :]])
        own, nuisances = rows[:, :m], rows[:, m:]
        own = own - nuisances @ np.linalg.lstsq(nuisances, own, rcond=None)[0]
        felt: BoolArray = np.linalg.norm(own[: squares.n], axis=0) * reach > _NOT_FELT
        return felt

    felt = at(start)
    if felt.all():
        return felt
    most = max(_ASKED, problem.settings.starts)
    others = [np.concatenate([row, start[m:]]) for row in points(squares, most)]
    squares.look_up(others)
    felt = np.logical_or.reduce([felt, *map(at, others)])
    squares.forget(others, start)
    return felt


def _values(squares: LeastSquares) -> str:
    return ", ".join(f"{key} = {value:g}" for key, value in squares.problem.start.items())


def refuse_reversed(squares: LeastSquares, start: FloatArray) -> None:
    """Refuse depths and masses that go against the model, but for their nuisances. Not collective.

    Those that do so only beside a drift or a compliance may be right, with a part that is not:
    ``opposing`` tells of it at the optimum.

    Raises
    ------
    InputError : one sentence a series.
    """
    model = squares.bare(start)
    faults = []
    for (experiment, series), part in zip(squares.series, squares.parts, strict=True):
        record = _Record(experiment, series, squares.sd[part], model[part])
        if series.quantity != "torque" and record.opposes() and record.opposes(harmless=True):
            faults.append(
                f'{squares.problem.name}: experiment "{legible(experiment.name)}": {series.name}: '
                "has the wrong sign: readings fall where the model's rise; must be positive where "
                "material is lost"
            )
    if faults:
        raise InputError(*faults)


class Opposition(NamedTuple):
    """A record that falls where the model's rises, beside its nuisances.

    Parameters
    ----------
    exclude : s, from when to when the readings are without which it does not; None: no part
        shorter than half of the record.
    """

    experiment: Experiment
    series: Series
    exclude: tuple[float, float] | None


def opposing(squares: LeastSquares, x: FloatArray) -> list[Opposition]:
    """Return records that go against the model at an optimum, for a part of them. Not collective.

    Parameters
    ----------
    x : (u,) unknowns.
    """
    model, found = squares.bare(x), []
    for (experiment, series), part in zip(squares.series, squares.parts, strict=True):
        record = _Record(experiment, series, squares.sd[part], model[part])
        if series.quantity != "torque" and not series.profile and record.opposes():
            found.append(Opposition(experiment, series, record.exclude))
    return found


class _Record:
    """Readings of a series and the model's, over their noise.

    Parameters
    ----------
    sd, model : (n,) noise, and the model's readings without nuisances.
    """

    def __init__(
        self, experiment: Experiment, series: Series, sd: FloatArray, model: FloatArray
    ) -> None:
        self._series = series
        self._columns = nuisance_columns(series, experiment.case) / sd[:, None]
        self._both = np.stack([series.value, model], axis=1) / sd[:, None]

    def opposes(self, rows: slice = slice(None), *, harmless: bool = False) -> bool:
        """Tell whether readings fall where the model's rise.

        Parameters
        ----------
        rows : of the readings that count.
        harmless : whether only nuisances count that leave the sign as it is.
        """
        of = [
            i for i, n in enumerate(self._series.nuisances) if not harmless or n.kind in _HARMLESS
        ]
        columns, both = self._columns[rows, of], self._both[rows]
        for column, i in enumerate(of):  # priors are one reading more, of the nuisance itself
            prior = self._series.nuisances[i].prior
            if prior is not None:
                columns = np.vstack([columns, np.eye(len(of))[column] / prior.sd])
                both = np.vstack([both, [prior.mean / prior.sd, 0.0]])
        both = both - columns @ np.linalg.lstsq(columns, both, rcond=None)[0]
        (data, wear), sizes = both.T, np.linalg.norm(both, axis=0)
        return bool(data @ wear < _OPPOSITE * sizes.prod() and -data @ wear > _SURE * sizes[1])

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
