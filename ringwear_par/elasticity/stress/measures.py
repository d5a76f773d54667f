"""What a stress amounts to: von Mises, maximum shear, principal values."""

import numpy as np

from ringwear_par.arrays import FloatArray

#: in the order of the last axis of stresses; tension is positive, z points upwards
COMPONENTS = ("rr", "tt", "zz", "rz", "rt", "tz")
#: of an interface, in the order of the axis of stresses there
SIDES = ("above", "below")


def mises(stress: FloatArray) -> FloatArray:
    """Return von Mises' equivalent (...) of stresses (..., 6)."""
    rr, tt, zz, rz, rt, tz = np.moveaxis(stress, -1, 0)
    normal = (rr - tt) ** 2 + (tt - zz) ** 2 + (zz - rr) ** 2
    return np.sqrt(0.5 * normal + 3.0 * (rz**2 + rt**2 + tz**2))


def principal(stress: FloatArray) -> FloatArray:
    """Return the principal values (..., 3) of stresses (..., 6), the largest first."""
    rr, tt, zz, rz, rt, tz = np.moveaxis(stress, -1, 0)
    tensor = np.stack([rr, rt, rz, rt, tt, tz, rz, tz, zz], axis=-1).reshape(*rr.shape, 3, 3)
    known = np.isfinite(stress).all(axis=-1)
    values = np.linalg.eigvalsh(np.where(known[..., None, None], tensor, 0.0))[..., ::-1]
    return np.where(known[..., None], values, np.nan)


def max_shear(stress: FloatArray) -> FloatArray:
    """Return the largest shear stress (...) of stresses (..., 6), half of Tresca's equivalent."""
    values = principal(stress)
    return 0.5 * (values[..., 0] - values[..., 2])
