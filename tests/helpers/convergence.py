"""Errors on meshes: the last is small enough, and they fall with the order of the method."""

import math

#: numbers of contact elements whose errors are compared
SIZES = (32, 64, 128)


def order(errors, sizes=SIZES, digits=1e-7):
    """Return the observed order over the last two sizes whose errors exceed the reference's own.

    None where there are not two of them. ``digits`` is the relative accuracy of the reference.
    """
    clear = [(n, e) for n, e in zip(sizes, map(abs, errors), strict=True) if e > 3.0 * digits]
    if len(clear) < 2:
        return None
    (n1, e1), (n2, e2) = clear[-2:]
    return math.log(e1 / e2) / math.log(n2 / n1)


def check_errors(errors, most, least_order=None, sizes=SIZES, digits=1e-7):
    """Assert that the last error is small enough (NaN is not), and that all fall with an order."""
    assert abs(errors[-1]) <= most, (errors, most)
    if least_order is not None:
        found = order(errors, sizes, digits)
        assert found is not None and found > least_order, (errors, found)  # noqa: PT018
