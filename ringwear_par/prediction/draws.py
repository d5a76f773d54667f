"""Draws of what a fit knows: values of its keys, and the random pace of wear."""

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.errors import ComputationError
from ringwear_par.identification.fitted_values import FittedValues

#: what a prediction is for
NEXT, MATERIAL = "next specimen", "material"
#: how often values beyond the bounds are drawn anew
_ROUNDS = 200
#: mean wear of a step over the size of the noise below which a step wears nothing, or almost never
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
    drawn, part, _ = draw_parts(values, of, draws, random)
    return drawn, values.sizes[part].T * (of != MATERIAL)


def draw_parts(
    values: FittedValues, of: str, draws: int, random: np.random.Generator
) -> tuple[FloatArray, IntArray, float]:
    """Return values of the fitted keys (draws, m), and the part of the mixture of each, (draws,).

    Values are within their bounds. Also returned is the share of all that are.

    Raises
    ------
    ComputationError : hardly any are within them.
    """
    low, high = values.bounds.T
    drawn, parts = np.zeros((0, len(values.keys))), np.zeros(0, dtype=np.int64)
    for number in range(1, _ROUNDS + 1):
        more, part_values = _values(values, of, draws, random)
        inside = ((more >= low) & (more <= high)).all(axis=1)
        drawn, parts = np.vstack([drawn, more[inside]]), np.append(parts, part_values[inside])
        if len(drawn) >= draws:
            return drawn[:draws], parts[:draws], len(drawn) / (number * draws)
    raise ComputationError(
        f"almost all values that the fit knows are beyond the bounds of {', '.join(values.keys)}"
    )


def _values(
    values: FittedValues, of: str, draws: int, random: np.random.Generator
) -> tuple[FloatArray, IntArray]:
    """Return values (draws, m), whatever their bounds, and the part (draws,) of each."""
    part = random.choice(len(values.weights), size=draws, p=values.weights)
    if values.samples is not None:
        return values.samples[random.integers(len(values.samples), size=draws)], part
    place = _place(values, of)
    scales, axes = np.linalg.eigh(values.covariances[:, place])  # of known keys they are singular
    roots = axes * np.sqrt(np.maximum(scales, 0.0))[:, None, :]
    normal = random.standard_normal((draws, len(values.keys)))
    unknowns = values.means[part, place] + np.einsum("dij,dj->di", roots[part], normal)
    if of == NEXT:
        shifts = values.scatters[part] * random.standard_normal((draws, len(values.scattering)))
        for level, key in enumerate(values.scattering):
            unknowns[:, key] += shifts[:, level]
    with np.errstate(over="ignore"):
        return np.where(values.logarithmic, np.exp(unknowns), unknowns), part


def _place(values: FittedValues, of: str) -> int:
    """Return the place of a specimen among those of the mixtures, or the material's."""
    return 0 if of in (NEXT, MATERIAL) else 1 + values.specimens.index(of)


def log_densities(values: FittedValues, of: str, unknowns: FloatArray) -> FloatArray:
    """Return logarithms (draws, g) of the density of ``draw_parts``, but for the bounds' share.

    Of each part of the mixture, its probability included.

    Parameters
    ----------
    unknowns : (draws, m) of the fitted keys.
    """
    place = _place(values, of)
    covariances = values.covariances[:, place].copy()
    if of == NEXT:
        for level, key in enumerate(values.scattering):
            covariances[:, key, key] += values.scatters[:, level] ** 2
    inverse = np.linalg.inv(np.linalg.cholesky(covariances))
    means = np.einsum("gij,gj->gi", inverse, values.means[:, place])
    squares = ((np.einsum("gij,dj->dgi", inverse, unknowns) - means) ** 2).sum(axis=2)
    volumes = np.log(np.diagonal(inverse, axis1=1, axis2=2)).sum(axis=1)
    constant = 0.5 * unknowns.shape[1] * np.log(2.0 * np.pi)
    logs: FloatArray = np.log(values.weights) + volumes - 0.5 * squares - constant
    return logs


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
