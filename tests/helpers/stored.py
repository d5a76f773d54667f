"""What result files hold."""

import h5py
import numpy as np


def contents(path):
    """Every dataset, the checkpoint included."""
    found = {}
    with h5py.File(path) as file:
        file.visititems(
            lambda name, item: found.update({name: item[()]}) if hasattr(item, "shape") else None
        )
    return found


def assert_same(whole, parts):
    """Two files hold the same to the last bit; return what the first holds."""
    one, two = contents(whole), contents(parts)
    assert one.keys() == two.keys()
    for name, value in one.items():
        floats = np.asarray(value).dtype.kind == "f"
        assert np.array_equal(value, two[name], equal_nan=floats), name
    return one
