"""An independent contact solver: the KKT system written out, sets changed one index at a time.

Deliberately simple and slow; numpy only, no code shared with the package's own solvers.
"""

import numpy as np


def solve(stiffness, area, gap, *, force=None, approach=None, laws=(), rise=None):
    """Return pressure and approach.

    Minimises 1/2 p.K p + Sum m (g - approach) p + Sum over laws of 1/2 m rise max(0, p - p0)^2
    for p >= 0. ``laws`` are thresholds p0, one rise (n,) each (wear of the step per MPa).
    """
    n = len(area)
    rise = [np.zeros(n) for _ in laws] if rise is None else rise
    contact = np.ones(n, dtype=bool)
    above = [np.zeros(n, dtype=bool) for _ in laws]
    for _ in range(200 * n):
        matrix, right = np.zeros((n + 1, n + 1)), np.zeros(n + 1)
        for e in range(n):
            if contact[e]:
                matrix[e, :n] = stiffness[e]
                matrix[e, n] = -area[e]
                right[e] = -area[e] * gap[e]
                for p0, slope, over in zip(laws, rise, above, strict=True):
                    if over[e]:
                        matrix[e, e] += area[e] * slope[e]
                        right[e] += area[e] * slope[e] * p0
            else:
                matrix[e, e] = 1.0
        if force is None:
            matrix[n, n], right[n] = 1.0, approach
        else:
            matrix[n, :n], right[n] = area, force
        x = np.linalg.solve(matrix, right)
        p, delta = x[:n], x[n]
        wear = sum((s * np.maximum(p - p0, 0) for p0, s in zip(laws, rise, strict=True)), 0 * p)
        opening = (stiffness @ p) / area + gap + wear - delta
        size, depth = np.abs(p).max() + 1e-300, np.abs(opening).max()
        wrong = []
        for e in range(n):
            if contact[e] and p[e] < -1e-13 * size:
                wrong.append((-p[e] / size, "off", e))
            elif not contact[e] and opening[e] < -1e-13 * depth:
                wrong.append((-opening[e] / depth, "on", e))
            for p0, over in zip(laws, above, strict=True):
                off = abs(p[e] - p0)
                if contact[e] and over[e] != (p[e] > p0) and off > 1e-13 * size:
                    wrong.append((off / size, over, e))
        if not wrong:
            return p, delta
        _, kind, e = max(wrong, key=lambda w: w[0])  # the most wrong one changes, alone
        if isinstance(kind, str):
            contact[e] = kind == "on"
        else:
            kind[e] = not kind[e]
    raise AssertionError("the reference active set did not settle")
