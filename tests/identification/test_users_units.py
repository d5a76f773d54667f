"""Keys in fit.json, in the unit of the user and as specific wear rates."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.fit import expected_result
from ringwear_par.identification.fit_numbers import specific_wear_rate
from ringwear_par.identification.summary import key_rows


def expected(tables, key="wear.lower.k"):
    """Return the entry of a key in fit.json, at its start."""
    fit = expected_result(read_fit(tables), MPI.COMM_SELF)
    return fit.to_dict()["parameters"][key]


def test_keys_are_stored_in_the_users_unit(good):
    tables = copy.deepcopy(good)
    tables["fit"]["parameters"]["wear.lower.k"]["start"] = "1.3e-4 mm3/(N m)"
    tables["fit"]["parameters"]["wear.lower.p0"]["start"] = 20.0
    entry = expected(tables)
    (row,) = key_rows("wear.lower.k", entry)  # once, not in the case's unit too
    assert row.unit == "mm3/(N m) per friction energy"
    assert row.estimate == pytest.approx(1.3e-4)
    for name in ("estimate", "sd", "interval"):
        assert getattr(row, name) == pytest.approx(1e3 * np.array(entry[name]))
    assert "specific_wear_rate" not in entry  # there is a threshold
    tables["fit"]["units"] = {"wear.lower.k": "um2/N", "wear.lower.p0": "bar"}
    assert expected(tables)["told"]["unit"] == "um2/N"
    p0 = expected(tables, "wear.lower.p0")["told"]
    assert p0["estimate"] == pytest.approx(200.0)
    assert "per" not in p0


def test_a_wear_coefficient_of_friction_energy_has_a_specific_wear_rate(good):
    tables = copy.deepcopy(good)
    del tables["fit"]["parameters"]["wear.lower.p0"]
    for experiment in tables["experiment"]:
        experiment["set"] |= {"wear.lower.p0": 0.0, "contact.friction": 0.1}
    entry = expected(tables)
    rate = entry["specific_wear_rate"]
    assert (rate["unit"], rate["mu"]) == ("mm3/(N m)", 0.1)
    for name in ("estimate", "sd", "interval"):
        assert rate[name] == pytest.approx(100.0 * np.array(entry[name]))
    assert rate["in3 min/(ft lbf h)"] == pytest.approx(rate["estimate"] / 201.44, rel=1e-4)
    # mu fitted too: standard deviations of logarithms, which depend on each other
    problem = read_fit(tables)
    friction = replace(problem.parameters[0], key="contact.friction")
    problem = replace(problem, parameters=(problem.parameters[0], friction))
    k, mu, rk, rm, rho = 1e-7, 0.2, 0.1, 0.05, -0.6
    entries = {
        "wear.lower.k": {
            "estimate": k,
            "sd": rk * k,
            "interval": [k / 1.2, 1.2 * k],
            "interval_of": "linear model",
        },
        "contact.friction": {"estimate": mu},
    }
    both = rho * rk * k * rm * mu
    covariance = [[(rk * k) ** 2, both], [both, (rm * mu) ** 2]]
    rate = specific_wear_rate(problem, "wear.lower.k", entries, covariance)
    assert rate["estimate"] == pytest.approx(1e3 * k * mu)
    sd = np.sqrt(rk**2 + rm**2 + 2.0 * rho * rk * rm)
    assert rate["sd"] == pytest.approx(sd * rate["estimate"])
    assert np.log(rate["interval"][1] / rate["estimate"]) == pytest.approx(1.959964 * sd)
    entries["wear.lower.k"]["interval_of"] = "scatter integrated"  # no normal distribution
    rate = specific_wear_rate(problem, "wear.lower.k", entries, covariance)
    assert rate["interval"] == [None, None]
