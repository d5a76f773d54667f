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


def attributes(path):
    """Attributes of a file and of its groups, but for what the computer needed."""
    found = {}

    def take(place, item):
        for name, value in item.attrs.items() if isinstance(item, h5py.Group) else ():
            if "seconds" not in name:
                found[f"{place}/{name}"] = np.asarray(value).tolist()

    with h5py.File(path) as file:
        take("", file)
        file.visititems(take)
    return found
