"""What result files hold."""

import h5py


def contents(path):
    """Every dataset, the checkpoint included."""
    found = {}
    with h5py.File(path) as file:
        file.visititems(
            lambda name, item: found.update({name: item[()]}) if hasattr(item, "shape") else None
        )
    return found
