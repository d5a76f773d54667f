"""Readings that cannot be what they are called, as the first histories tell."""

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import InputError, legible
from ringwear_par.identification.least_squares import LeastSquares
from ringwear_par.identification.readings import nuisance_columns

#: of the noise of all its readings: less is no response, over the whole of all bounds
_NO_RESPONSE = 1e-6
#: correlation of readings with the model below which they have the wrong sign, and at how many sd
_OPPOSITE, _SURE = -0.5, 5.0


def refuse_idle(squares: LeastSquares, start: FloatArray) -> None:
    """Refuse quantities that respond to no parameter. Not collective.

    Raises
    ------
    InputError : one sentence a series.
    """
    m = len(squares.problem.parameters)
    columns = squares.evaluate(start).noise_jacobian[:, :m] * (squares.upper - squares.lower)[:m]
    faults = [
        f'{squares.problem.name}: experiment "{legible(experiment.name)}": {series.name}: does not '
        f"respond to any parameter at its start ({_values(squares)}); must respond to one at least"
        for (experiment, series), part in zip(squares.series, squares.parts, strict=True)
        if np.linalg.norm(columns[part]) < _NO_RESPONSE
    ]
    if faults:
        raise InputError(*faults)


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
