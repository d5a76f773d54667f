"""The paper's law of an averaged pressure.

The same average is taken of the pressure and of the rate: pressure felt at a distance wears at
that distance. Taken of the pressure only, a step would no longer be a minimisation, nor its
solution be sure to exist. ``rate`` is that of a pressure already averaged; ``WearIncrement`` takes
the averages.
"""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError
from ringwear_par.wear.law import Law, Parameter
from ringwear_par.wear.laws.threshold import ThresholdLaw
from ringwear_par.wear.local_state import LocalState


@dataclass(frozen=True)
class NonLocalLaw(ThresholdLaw):
    """The threshold law of a pressure that is averaged over a length.

    The threshold law, k in 1/MPa and p0 in MPa, with the pressure averaged by a Gaussian of the
    standard deviation ``length`` (mm) along the radius. The wear is averaged in the same way, which
    does not change the worn volume.

    Use it where peaks of pressure narrower than a grain, a particle or the spacing of asperities
    should not wear by themselves. At a sharp edge the elastic pressure is infinite. With the other
    laws, the wear rate there depends on the size of the elements; with this law, on ``length``.

    Speed and friction are not averaged. Profiles cannot bend within ``length``, so grooves and
    steps narrower than ``length`` are smoothed too. Fit ``length`` to profiles near edges.
    """

    name = "non-local"
    formula = "<k mu max(0, <p> - p0) V> (<> averages over length)"
    steady = True

    length: Annotated[
        float,
        Parameter(
            "mm",
            "standard deviation of the Gaussian average of the pressure, and of the wear that it "
            "causes",
            "number",
            ends=False,
            local=False,
        ),
    ] = field(kw_only=True)

    def per_energy(self, friction: float) -> float | None:
        """Return None: the sliding speed is not averaged."""
        return None


#: most scalings of averages, and the error of averaged constants that is allowed after them
_SCALINGS, _SCALED = 1000, 1e-10


def averaging(r: FloatArray, area: FloatArray, length: float) -> FloatArray:
    """Return the (n, n) matrix of Gaussian averages over a length.

    Rows sum to 1 and ``diag(area) A`` is symmetric, so that constants and area integrals are
    kept (Sinkhorn's scaling).

    Raises
    ------
    ComputationError : the scaling does not settle.
    """
    if length == 0.0:
        return np.eye(len(r))
    kernel = np.exp(-0.5 * ((r[:, None] - r) / length) ** 2) * area[:, None] * area
    scale = 1.0 / np.sqrt(kernel.sum(axis=1) / area)
    for _ in range(_SCALINGS):
        sums = scale * (kernel @ scale) / area
        error = np.abs(sums - 1.0).max()
        if error < 1e-14:
            break
        scale = scale / np.sqrt(sums)
    if not error <= _SCALED:
        raise ComputationError(
            f"wear law: averages over {length:g} mm keep constants to {error:.1e} only, "
            f"after {_SCALINGS} scalings (allowed {_SCALED:g})"
        )
    symmetric = scale[:, None] * kernel * scale
    matrix = symmetric / area[:, None]
    return matrix / matrix.sum(axis=1)[:, None]


def averaged(average: FloatArray, x: FloatArray) -> FloatArray:
    """Return averages, (..., n), of x, without BLAS: its rounding may turn on where x lies.

    Parameters
    ----------
    average : (..., n, n) float.
    """
    products: FloatArray = average * x[..., None, :]
    return products.sum(axis=-1)


def averaged_rate(
    law: Law, at: LocalState, average: FloatArray | None, p: FloatArray
) -> FloatArray:
    """Return the rate of wear under a law, (..., n) mm/s, with its average if it is non-local."""
    if average is None:
        return law.rate(p, at)
    return averaged(average, law.rate(averaged(average, p), at))
