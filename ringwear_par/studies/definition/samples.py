"""Points of sampled designs in the unit cube, the same with any version of SciPy.

Those that ``scipy.stats.qmc`` draws, which takes longer to import than a sweep does to begin.
"""

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray

#: binary digits of a Sobol' point
_DIGITS = 30
#: of each axis but the first a primitive polynomial, its digits those of a number, and the first
#: direction numbers (S. Joe and F. Y. Kuo, SIAM J. Sci. Comput. 30 (2008) 2635, new-joe-kuo-6)
_DIRECTIONS = """
    3 1, 7 1 3, 11 1 3 1, 13 1 1 1, 19 1 1 3 3, 25 1 3 5 13, 37 1 1 5 5 17, 41 1 1 5 5
    5, 47 1 1 7 11 19, 55 1 1 5 1 1, 59 1 1 1 3 11, 61 1 3 5 5 31, 67 1 3 3 9 7 49, 91 1
    1 1 15 21 21, 97 1 3 1 13 27 49, 103 1 1 1 15 7 5, 109 1 3 1 15 13 25, 115 1 1 5 5
    19 61, 131 1 3 7 11 23 15 103, 137 1 3 7 13 13 15 69, 143 1 1 3 13 7 35 63, 145 1 3
    5 9 1 25 53, 157 1 3 1 13 9 35 107, 167 1 3 1 5 27 61 31, 171 1 1 5 11 19 41 61, 185
    1 3 5 3 3 13 69, 191 1 1 7 13 1 19 1, 193 1 3 7 5 13 19 59, 203 1 1 3 9 25 29 41,
    211 1 3 5 13 23 1 55, 213 1 3 7 3 13 59 17, 229 1 3 1 3 5 53 69, 239 1 1 5 5 23 33
    13, 241 1 1 7 7 1 61 123, 247 1 1 7 9 13 61 49, 253 1 3 3 5 3 55 33, 285 1 3 1 15 31
    13 49 245, 299 1 3 5 15 31 59 63 97, 301 1 3 1 11 11 11 77 249, 333 1 3 1 11 27 43
    71 9, 351 1 1 7 15 21 11 81 45, 355 1 3 7 3 25 31 65 79, 357 1 3 1 1 19 11 3 205,
    361 1 1 5 9 19 21 29 157, 369 1 3 7 11 1 33 89 185, 391 1 3 3 3 15 9 79 71, 397 1 3
    7 11 15 39 119 27, 425 1 1 3 1 11 31 97 225, 451 1 1 1 3 23 43 57 177, 463 1 3 7 7
    17 17 37 71, 487 1 3 1 5 27 63 123 213, 501 1 1 3 5 11 43 53 133, 529 1 3 5 5 29 17
    47 173 479, 539 1 3 3 11 3 1 109 9 69, 545 1 1 1 5 17 39 23 5 343, 557 1 3 1 5 25 15
    31 103 499, 563 1 1 1 11 11 17 63 105 183, 601 1 1 5 11 9 29 97 231 363, 607 1 1 5
    15 19 45 41 7 383, 617 1 3 7 7 31 19 83 137 221, 623 1 1 1 3 23 15 111 223 83, 631 1
    1 5 13 31 15 55 25 161, 637 1 1 3 13 25 47 39 87 257
"""
_AXES = [[int(word) for word in axis.split()] for axis in _DIRECTIONS.split(",")]
#: most axes of a Sobol' design
MOST_AXES = 1 + len(_AXES)


def sobol(count: int, axes: int, seed: int) -> FloatArray:
    """Return (count, axes) points of a scrambled Sobol' sequence; longer ones begin with them.

    Scrambled by a random lower triangular matrix of digits and a digital shift (J. Matousek,
    J. Complexity 14 (1998) 527).
    """
    rng, weights = np.random.default_rng(seed), 1 << np.arange(_DIGITS)[::-1]
    shifts = rng.integers(2, size=(axes, _DIGITS), dtype=np.uint32) @ weights[::-1]
    matrices = rng.integers(2, size=(axes, _DIGITS, _DIGITS), dtype=np.uint32)
    points = np.empty((count, axes))
    for axis in range(axes):
        scramble = np.tril(matrices[axis], -1) + np.eye(_DIGITS, dtype=np.int64)
        digits = _directions(axis)[:, None] // weights % 2  # the most significant first
        directions = (digits @ scramble.T % 2) @ weights
        numbers = shifts[axis : axis + 1].astype(np.int64)
        for direction in directions.tolist():  # in the order of Gray's code
            if len(numbers) >= count:
                break
            numbers = np.concatenate([numbers, numbers[::-1] ^ direction])
        points[:, axis] = numbers[:count] / 2.0**_DIGITS
    return points


def _directions(axis: int) -> IntArray:
    """Return the direction numbers of an axis, (digits,)."""
    polynomial, *numbers = _AXES[axis - 1] if axis else (1, *[1] * _DIGITS)
    degree = len(numbers)
    for j in range(degree, _DIGITS):
        number = numbers[j - degree]
        for k in range(1, degree + 1):
            if polynomial >> (degree - k) & 1:
                number ^= numbers[j - k] << k
        numbers.append(number)
    return np.array(numbers) << np.arange(_DIGITS)[::-1]


def latin_hypercube(count: int, axes: int, seed: int) -> FloatArray:
    """Return (count, axes) points, one in each of ``count`` equal intervals of each axis."""
    rng = np.random.default_rng(seed)
    inside, cells = rng.uniform(size=(count, axes)), np.tile(np.arange(1, count + 1), (axes, 1))
    for cells_of_axis in cells:
        rng.shuffle(cells_of_axis)
    return (cells.T - inside) / count
