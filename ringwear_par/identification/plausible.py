"""Readings that cannot be what they are called, as the first histories tell."""

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.errors import ComputationError, InputError, legible
from ringwear_par.identification.least_squares import LeastSquares
from ringwear_par.identification.readings import nuisance_columns
from ringwear_par.identification.starts import points

#: of the noise of all its readings: less is no response, over the whole of all bounds
_NO_RESPONSE = 1e-6
#: of the noise of all readings: a key by which they change less is not felt, over a factor of e
#: where its logarithm is sought, else over ten times the whole of its bounds
_NOT_FELT, _WIDTHS = 0.5, 10.0
#: points that are asked at least
_ASKED = 8
#: correlation of readings with the model below which they have the wrong sign, and at how many sd
_OPPOSITE, _SURE = -0.5, 5.0


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
    others = [np.concatenate([row, start[m:]]) for row in points(problem, most)]
    squares.look_up(others)
    felt = np.logical_or.reduce([felt, *map(at, others)])
    squares.forget(others, start)
    return felt


def _values(squares: LeastSquares) -> str:
    return ", ".join(f"{key} = {value:g}" for key, value in squares.problem.start.items())


def refuse_reversed(squares: LeastSquares, start: FloatArray) -> None:
    """Refuse depths and masses that go against the model, but for their nuisances. Not collective.

    Raises
    ------
    InputError : one sentence a series.
    """
    model, sd = squares.bare(start), squares.sd
    faults = []
    for (experiment, series), part in zip(squares.series, squares.parts, strict=True):
        if series.quantity == "torque":  # it may fall where the model's rises
            continue
        priors = [(i, n.prior) for i, n in enumerate(series.nuisances) if n.prior is not None]
        columns = nuisance_columns(series, experiment.case) / sd[part][:, None]
        both = np.stack([series.value, model[part]], axis=1) / sd[part][:, None]
        for i, prior in priors:  # as one reading more, of the nuisance itself
            columns = np.vstack([columns, np.eye(columns.shape[1])[i] / prior.sd])
            both = np.vstack([both, [prior.mean / prior.sd, 0.0]])
        both = both - columns @ np.linalg.lstsq(columns, both, rcond=None)[0]
        (data, wear), sizes = both.T, np.linalg.norm(both, axis=0)
        if data @ wear < _OPPOSITE * sizes.prod() and -data @ wear > _SURE * sizes[1]:
            faults.append(
                f'{squares.problem.name}: experiment "{legible(experiment.name)}": {series.name}: '
                "has the wrong sign: readings fall where the model's rise; must be positive where "
                "material is lost"
            )
    if faults:
        raise InputError(*faults)
