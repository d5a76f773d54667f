"""The script that makes the tables of coverage: a set of a small laboratory."""

import numpy as np
from fit_coverage import Laboratory, laboratories, one_set


def test_a_set_is_fitted():
    scores = one_set(Laboratory(*laboratories()["2-specimens"]), 0)
    assert list(scores) == ["k (%)", "scatter (%)", "next specimen (%)"]
    half_widths = np.array([half for _, half in scores.values()])
    assert (np.isfinite(half_widths) & (half_widths > 0.0)).all()
