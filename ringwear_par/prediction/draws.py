"""Draws of what a fit knows: values of its keys, and the random pace of wear."""

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError
from ringwear_par.identification.fitted_values import FittedValues

#: of whom predictions are
NEXT, MATERIAL = "next specimen", "material"
#: how often values beyond the bounds are drawn anew
_ROUNDS = 200
#: of a step's mean wear over the size of the noise: below it a step wears nothing, or almost never
_LEAST_SHAPE = 1e-12


def draw_values(
    values: FittedValues, of: str, draws: int, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return values of the fitted keys (draws, m), and sizes of the process noise (2, draws) mm.

    Values are within their bounds. The material has no process noise.

    Raises
    ------
    ComputationError : hardly any are within them.
    """
    low, high = values.bounds.T
    drawn, sizes = np.zeros((0, len(values.keys))), np.zeros((0, 2))
    for _ in range(_ROUNDS):
        more, noise = _values(values, of, draws, random)
        inside = ((more >= low) & (more <= high)).all(axis=1)
        drawn, sizes = np.vstack([drawn, more[inside]]), np.vstack([sizes, noise[inside]])
        if len(drawn) >= draws:
            return drawn[:draws], sizes[:draws].T * (of != MATERIAL)
    raise ComputationError(
        f"almost all values that the fit knows are beyond the bounds of {', '.join(values.keys)}"
    )


def _values(
    values: FittedValues, of: str, draws: int, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return values (draws, m), whatever their bounds, and sizes of the noise (draws, 2)."""
    part = random.choice(len(values.weights), size=draws, p=values.weights)
    if values.samples is not None:
        return values.samples[random.integers(len(values.samples), size=draws)], values.sizes[part]
    place = 0 if of in (NEXT, MATERIAL) else 1 + values.specimens.index(of)
    scales, axes = np.linalg.eigh(values.covariances[:, place])  # of known keys they are singular
    roots = axes * np.sqrt(np.maximum(scales, 0.0))[:, None, :]
    normal = random.standard_normal((draws, len(values.keys)))
    unknowns = values.means[part, place] + np.einsum("dij,dj->di", roots[part], normal)
    if of == NEXT:
        shifts = values.scatters[part] * random.standard_normal((draws, len(values.scattering)))
        for level, key in enumerate(values.scattering):
            unknowns[:, key] += shifts[:, level]
    with np.errstate(over="ignore"):
        return np.where(values.logarithmic, np.exp(unknowns), unknowns), values.sizes[part]


def draw_paces(depths: FloatArray, sizes: FloatArray, random: np.random.Generator) -> FloatArray:
    """Return factors on the rates of steps, (draws, 2, steps), of means 1.

    Worn depth becomes a gamma process: its increment over a mean increment dS has a mean dS and a
    variance size dS.

    Parameters
    ----------
    depths : (draws, 2, steps) float, mm, mean worn depths of lower and upper at the ends of steps.
    sizes : (2, draws) float, mm; 0: no noise.
    """
    increments = np.diff(depths, axis=-1, prepend=0.0)
    sizes = np.broadcast_to(sizes.T[:, :, None], increments.shape)
    shapes = np.divide(increments, sizes, out=np.zeros_like(increments), where=sizes > 0.0)
    paces = np.ones_like(increments)
    noisy = shapes > _LEAST_SHAPE
    paces[noisy] = random.gamma(shapes[noisy]) / shapes[noisy]
    return paces
