"""Errors on meshes: the last is small enough, and they fall with the order of the method."""

import math

#: numbers of contact elements whose errors are compared
SIZES = (32, 64, 128)


def order(errors, sizes=SIZES, digits=1e-7):
    """Return the observed order over the last two sizes whose errors exceed the reference's own.

    NaN where there are not two of them. ``digits`` is the relative accuracy of the reference.
    """
    clear = [(n, e) for n, e in zip(sizes, errors, strict=True) if e > 3.0 * digits]
    if len(clear) < 2:
        return math.nan
    (n1, e1), (n2, e2) = clear[-2:]
    return math.log(e1 / e2) / math.log(n2 / n1)


def check_errors(errors, limits, sizes=SIZES):
    """Assert that errors are small enough on the last mesh (NaN is not), and fall with an order.

    Parameters
    ----------
    errors : function of the number of elements, to errors by their names.
    limits : by name the largest last error, the least order or None, and where it is not 1e-7 the
        relative accuracy of the reference.

    Returns
    -------
    The errors of each size by their names.
    """
    found = [{name: abs(float(e)) for name, e in errors(n).items()} for n in sizes]
    assert found[0].keys() == limits.keys()
    for name, (most, least, *digits) in limits.items():
        values = [one[name] for one in found]
        assert values[-1] <= most, (name, values)
        assert least is None or order(values, sizes, *digits) > least, (name, values)
    return found
