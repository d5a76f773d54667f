"""How far histories that are stepped side by side may be from those of single runs.

Contact within blocks is solved to 1e-4 of the largest pressure and to a part of the tolerance of
wear, alone to 1e-8: the same steps then wear the same to some hundredths of the tolerance.
"""

import numpy as np


def most_off(values, tolerance=1e-5):
    """Return by how much numbers may be off those of a single run; tolerance in mm."""
    return 5e-4 * np.abs(values).max() + 0.05 * tolerance


def assert_agree(found, exact, tolerance=1e-5):
    """Two results are the same to the accuracy of contact within blocks; tolerance in mm."""
    assert np.array_equal(found.step, exact.step)
    assert found.histories["time"].tolist() == exact.histories["time"].tolist()
    own = {**found.histories, **found.profiles}
    for name, values in (exact.histories | exact.profiles).items():
        assert (own[name].shape, own[name].dtype) == (values.shape, values.dtype), name
    assert_values_agree(own, exact, tolerance)


def assert_values_agree(found, exact, tolerance=1e-5):
    """Values by name, of a history that was stepped beside others, are those of a result."""
    for name, values in (exact.histories | exact.profiles).items():
        if name != "contact_iterations":
            assert np.abs(found[name] - values).max() <= most_off(values, tolerance), name
