"""Keys in fit.json, in the unit of the user and as specific wear rates; verdicts by draws."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import expon, uniform

from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.fitted_parameters import units_of
from ringwear_par.identification.key_estimates import in_users_unit, judged, specific_wear_rate
from ringwear_par.identification.summary import digits_within, key_rows, limits, number

K, P0 = "wear.lower.k", "wear.lower.p0"
ENTRY = {"estimate": 1.3e-7, "sd": 1e-9, "interval": [1.28e-7, 1.32e-7], "verdict": "identified",
         "unit": "1/MPa"}  # fmt: skip
DRAWS = np.random.default_rng(0).standard_normal(20_000)


def test_keys_are_stored_in_the_users_unit(tables):
    given = tables()
    given["fit"]["parameters"][K]["start"] = "1.3e-4 mm3/(N m)"
    given["fit"]["units"] = {P0: "bar"}
    problem = read_fit(given)
    (k, p0), case = problem.parameters, problem.experiments[0].case
    told = in_users_unit(k, ENTRY, case)
    (row,) = key_rows(K, {**ENTRY, "told": told})  # once, not in the case's unit too
    assert row.value == "0.00013 mm3/(N m) per friction energy"
    stored = ENTRY["estimate"], ENTRY["sd"], *ENTRY["interval"]
    assert row[1:5] == pytest.approx(1e3 * np.array(stored))
    bar = in_users_unit(p0, {"estimate": 20.0, "sd": 1.0, "interval": [None, 22.0]}, case)
    assert bar["estimate"] == pytest.approx(200.0)
    assert bar["interval"] == [None, pytest.approx(220.0)]
    assert "per" not in bar
    # there is a threshold
    assert specific_wear_rate(problem, K, ENTRY, np.zeros((2, 2))) is None


def test_units_are_those_of_the_law(tables):
    given = tables()
    del given["fit"]["parameters"][P0]
    law = {"wear.lower.law": "power", "wear.lower.m": 1.0, "wear.lower.n": 1.0, P0: None}
    for experiment in given["experiment"]:
        experiment["set"] = {**law, **experiment["set"]}
    assert units_of(read_fit(given)) == {K: "mm/s"}


def test_a_wear_coefficient_of_friction_energy_has_a_specific_wear_rate(tables):
    given = tables()
    del given["fit"]["parameters"][P0]
    for experiment in given["experiment"]:
        experiment["set"] |= {P0: 0.0, "contact.friction": 0.1}
    problem = read_fit(given)
    k = np.exp(np.log(1.3e-7) + 0.1 * DRAWS)
    entry = {**ENTRY, "estimate": np.median(k), "sd": k.std(),
             "interval": np.quantile(k, [0.025, 0.975]).tolist()}  # fmt: skip
    rate = specific_wear_rate(problem, K, entry, k[:, None])
    assert (rate["unit"], rate["mu"]) == ("mm3/(N m)", 0.1)
    for name in ("estimate", "sd", "interval"):
        assert rate[name] == pytest.approx(100.0 * np.array(entry[name]), rel=0.01)
    assert rate["in3 min/(ft lbf h)"] == pytest.approx(rate["estimate"] / 201.44, rel=1e-4)
    # mu fitted too, which k depends on
    friction = replace(problem.parameters[0], key="contact.friction")
    problem = replace(problem, parameters=(problem.parameters[0], friction))
    mu = 0.2 * np.exp(-0.08 * DRAWS)
    rate = specific_wear_rate(problem, K, entry, np.column_stack([k, mu]))
    assert rate["estimate"] == pytest.approx(1e3 * 1.3e-7 * 0.2, rel=0.01)
    assert np.log(rate["interval"][1] / rate["estimate"]) == pytest.approx(1.96 * 0.02, rel=0.05)


@pytest.mark.parametrize(
    ("draws", "verdict", "ends"),
    [
        (3.0 + 0.5 * DRAWS, "identified", [2.02, 3.98]),
        (expon.ppf(uniform.cdf(np.linspace(1e-4, 0.9999, 9999))), "at bound", [None, 3.0]),
        (10.0 - expon.ppf(np.linspace(1e-4, 0.9999, 9999)), "at bound", [7.0, None]),
        (np.linspace(0.0, 10.0, 9999), "not identified", [None, None]),
        (np.clip(5.0 + 1.8 * DRAWS, 0.01, 9.99), "not identified", [1.47, 8.53]),
    ],
)
def test_verdicts(draws, verdict, ends):
    """Of a key between 0 and 10, flat before: of sd 2.9."""
    found, interval = judged(draws, 0.0, 10.0, 10.0 / np.sqrt(12.0), 0.95)
    assert found == verdict
    for one, end in zip(interval, ends, strict=True):
        assert one == (None if end is None else pytest.approx(end, abs=0.05))


def test_numbers_as_people_read_them():
    """No more digits than draws know, no exponent up to a million."""
    assert digits_within(1.0e-7, 1.6e-7) == 3
    assert digits_within(24.9, 25.1) == 4
    assert [number(v) for v in (34567.0, 1.2345e-7, 2.5)] == ["34600", "1.23e-07", "2.5"]
    words = ["less than 0.5", "more than 0.5", "no limit within its bounds"]
    assert [limits(*ends) for ends in ([None, 0.5], [0.5, None], [None, None])] == words
