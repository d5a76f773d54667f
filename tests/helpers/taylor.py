"""Taylor tests: ``|f(h) - f(0) - h f'(0)|`` falls with order 2 where f' is the derivative."""

import numpy as np


def taylor_order(f, slope, scale, noise=0.0):
    """Return the smallest observed order, infinity where nothing but round-off is left.

    Parameters
    ----------
    f, slope : functions of h that return values along a line, (n,), and their derivatives.
    scale : of h, which is halved from scale / 2^8 on.
    noise : round-off of f, relative to its largest value.
    """
    along, start = slope(0.0), f(0.0)
    steps = scale * 2.0 ** -np.arange(8.0, 13.0)
    off = np.array([np.abs(f(h) - start - h * along) for h in steps]).max(axis=1)
    off = np.maximum(off - noise * np.abs(start).max(), 0.0)
    left = off[1:] > 1e-9 * steps[1:] * (np.abs(along).max() or 1.0)
    return np.log2(off[:-1][left] / off[1:][left]).min(initial=np.inf)
