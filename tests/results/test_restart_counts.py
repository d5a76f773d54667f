"""A run that is made longer has all numbers and counts of one that was as long at once."""

import h5py
import numpy as np
from commands import ringwear
from paths import PAPER
from stored import assert_same

MOVING = ["mesh.contact_elements=16", "mesh.geometry=updated", "mesh.geometry_tolerance=0.001",
          "time.step=4"]  # fmt: skip


def counts(path):
    """Return the attributes of a file and of its groups, but for what the computer needed."""
    found = {}

    def take(place, item):
        for name, value in item.attrs.items() if isinstance(item, h5py.Group) else ():
            if "seconds" not in name:
                found[f"{place}/{name}"] = np.asarray(value).tolist()

    with h5py.File(path) as file:
        take("", file)
        file.visititems(take)
    return found


def test_a_longer_run_with_moving_geometry_has_all_counts(tmp_path):
    whole, parts = tmp_path / "whole.h5", tmp_path / "parts.h5"
    for path, steps, how in ((whole, 20, []), (parts, 9, []), (parts, 20, ["--restart"])):
        keys = [*MOVING, f"time.steps={steps}"]
        done = ringwear("run", PAPER, "-o", path, *how, "--set", *keys)
        assert done.returncode == 0, done.stderr
    assert_same(whole, parts)
    one, other = counts(whole), counts(parts)
    assert one == other
    assert one["checkpoint/assemblies"] > 4
