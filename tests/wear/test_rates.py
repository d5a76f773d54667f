"""Rates of the laws by their formulas, at speeds and coefficients of friction that are not 1."""

import numpy as np
import pytest
from mpi4py import MPI
from paths import PAPER

import ringwear_par as rw
from ringwear_par.wear import LocalState

MU, P = 0.3, np.array([5.0, 20.0, 80.0])
R = np.array([10.0, 15.0, 20.0])
V, SLID = 4.0 * R, np.array([100.0, 200.0, 400.0])
#: keys of wear.lower, and their rate, mm/s
RATES = {
    "threshold": ({"k": 1e-7, "p0": 10.0}, 1e-7 * MU * np.maximum(P - 10.0, 0.0) * V),
    "archard": ({"k": 1e-8}, 1e-8 * P * V),
    "power": ({"k": 1e-9, "m": 1.5, "n": 0.5}, 1e-9 * P**1.5 * V**0.5),
    "running-in": (
        {"k": 1e-7, "k_start": 5e-7, "p0": 10.0, "distance": 150.0},
        (1e-7 + 4e-7 * np.exp(-SLID / 150.0)) * MU * np.maximum(P - 10.0, 0.0) * V,
    ),
    "table": (
        {"table": [[0.0, 0.0], [1000.0, 1e-5], [4000.0, 1e-4]]},
        np.interp(P * V, [0.0, 1000.0, 4000.0, 8000.0], [0.0, 1e-5, 1e-4, 2.2e-4]),
    ),
}  # fmt: skip


@pytest.mark.parametrize("law", RATES)
def test_rates_are_their_formulas(law):
    keys, exact = RATES[law]
    case = rw.read_case(PAPER, {"wear.lower": {"law": law, **keys}})
    local = LocalState(0.0, R, V, MU, np.zeros(3), SLID)
    assert case.wear_lower.rate(P, local) == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("law", ["threshold", "archard"])
def test_volume_by_energy_is_what_the_law_says(law):
    """Without a threshold it is k, by Archard's law k / mu; and the run has checked that."""
    keys = {"wear.lower.law": law, "wear.lower.k": 1e-8, "contact.friction": MU}
    keys |= {"mesh.contact_elements": 16, "time.steps": 5} | (
        {"wear.lower.p0": 0.0} if law == "threshold" else {}
    )
    result = rw.simulate(rw.read_case(PAPER, keys), MPI.COMM_SELF)
    last = {name: values[-1] for name, values in result.histories.items()}
    ratio = 1e-8 if law == "threshold" else 1e-8 / MU
    assert last["worn_volume_lower"] == pytest.approx(ratio * last["dissipated_energy"], rel=1e-12)
    assert result.attributes["energy_identity"]
    assert result.balances["energy"] < 1e-12
