"""Adaptive steps keep their tolerance over the whole history, in every case of the repository."""

import tomllib

import numpy as np
import pytest
from mpi4py import MPI
from paths import CASES

import ringwear_par as rw

pytestmark = pytest.mark.slow

ADAPTIVE = [
    path.stem
    for path in sorted(CASES.glob("*.toml"))
    if tomllib.loads(path.read_text()).get("time", {}).get("scheme") == "adaptive"
]
#: other tolerances, mm, of contacts that grow too, and of cases whose files have fixed steps
OTHERS = [("crown", 1e-5), ("crown", 1e-6), ("sphere", 1e-5), ("paper", 1e-6), ("chamfer", 1e-5),
          ("overlap", 1e-5)]  # fmt: skip
#: coarse elements that come into contact one after another, which the estimate leaves out
GROWS = pytest.param(
    "sphere", 1e-6, marks=pytest.mark.xfail(reason="5 tolerances off: not estimated", strict=True)
)


def wear(case, tolerance):
    """Return the depths of both bodies after 5 %, 30 % and all of a case's time, (3, 2, n) mm."""
    end = case.time.end
    case = case.replace({
        "time": {"scheme": "adaptive", "end": end, "tolerance": tolerance},
        "output": {"times": [0.05 * end, 0.3 * end, end]},
    })  # fmt: skip
    result = rw.simulate(case, MPI.COMM_SELF)
    return np.stack([result.profiles[f"wear_{body}"][-3:] for body in ("lower", "upper")], axis=1)


@pytest.mark.parametrize(
    ("name", "tolerance"), [*((name, None) for name in ADAPTIVE), *OTHERS, GROWS]
)
def test_wear_is_within_two_tolerances_of_that_in_finer_steps(name, tolerance):
    """One would be right; crown.toml, in coming into contact, needs 1.6."""
    case = rw.read_case(CASES / f"{name}.toml", {"mesh.contact_elements": 16})
    tolerance = tolerance or case.time.tolerance
    exact = wear(case, tolerance / 100)
    assert (np.abs(exact[-1]) > tolerance).any()
    assert np.abs(wear(case, tolerance) - exact).max() < 2.0 * tolerance
