"""Numbers of laboratories: as they are defined, and the same in runs, sweeps and fits' folders."""

import csv

import numpy as np
import pytest
from mpi4py import MPI
from parts import main
from paths import PAPER

import ringwear_par as rw
from ringwear_par.results.key_numbers import key_numbers

K, RADIUS = 1e-8, 30.0
#: Archard's law on flat rings whose speed rises and whose load steps; a density of lower only
KEYS = {
    "wear.lower": None, "wear.lower.law": "archard", "wear.lower.k": K, "contact.friction": 0.2,
    "lower.density": 7.85e-3, "load.pressure": [[0.0, 20.0], [50.0, 20.0], [60.0, 40.0]],
    "load.omega": [[0.0, 1.0], [100.0, 3.0]], "mesh.contact_elements": 12,
    "time.scheme": "adaptive", "time.end": 100.0, "output.times": [25.0, 50.0, 100.0],
}  # fmt: skip
#: of summaries, by variables of files
KEY_NUMBERS = {
    "mass_lost_lower": "lower_mass", "mean_wear_rate_lower": "lower_mean_rate",
    "specific_wear_rate_lower": "lower_specific_rate", "sliding_distance": "distance",
    "pressure_velocity": "p_v",
}  # fmt: skip


@pytest.fixture(scope="module")
def case():
    return rw.read_case(PAPER, KEYS)


def test_they_are_as_defined(case):
    result = rw.simulate(case, MPI.COMM_SELF)
    data = result.to_xarray()
    t = data.time.values
    assert data.sliding_distance.values == pytest.approx(1e-3 * RADIUS * (t + 0.01 * t**2))
    assert data.mass_lost_lower.values == pytest.approx(7.85 * data.worn_volume_lower.values)
    p = np.interp(t, [50.0, 60.0], [20.0, 40.0])
    assert data.pressure_velocity.values == pytest.approx(1e-3 * p * RADIUS * (1.0 + 0.02 * t))
    hours = t[1:] / 3600.0
    rate = 1e3 * data.worn_volume_lower.values[1:] / (case.area * hours)
    assert data.mean_wear_rate_lower.values[1:] == pytest.approx(rate)
    # of Archard's law the rate is k p V, so that it is 1000 k in mm3/(N m) at all times
    assert data.specific_wear_rate_lower.values[1:] == pytest.approx(1e3 * K, rel=1e-9)
    assert not {"mass_lost_upper", "specific_wear_rate_upper"} & set(data)
    # the last ones in words, with what else a tribologist asks for
    numbers = result.to_dict()["numbers"]
    for name, variable in KEY_NUMBERS.items():
        exact = {"value": float(data[name][-1]), "unit": data[name].units}
        assert numbers[variable] == exact
    for name, value in (
        ("speed", 3.0 * RADIUS), ("torque", 1e-3 * data.torque[-1]),
        ("dissipated_energy", 1e-3 * data.dissipated_energy[-1]),
        ("largest_pressure", data.pressure[-1].max()),
    ):  # fmt: skip
        assert numbers[name]["value"] == pytest.approx(float(value), rel=1e-12)
    assert "1e-05 mm3/(N m)" in result.summary()


def test_sweeps_have_those_of_runs(case, tmp_path):
    """In results.h5, cases.csv and exported tables; one of the cases knows no density."""
    study = {
        "case": str(tmp_path / "case.toml"),
        "vary": {"load.omega": {"values": [1.0, 2.0]}, "lower.density": {"values": [1e-3, 2e-3]}},
    }
    (tmp_path / "case.toml").write_text(case.text)
    rw.sweep(rw.read_study(study), tmp_path / "out", MPI.COMM_SELF)
    with rw.open_ensemble(tmp_path / "out") as data:
        data.load()
    omega, density = data["load.omega"].values, data["lower.density"].values
    rows = [*csv.DictReader((tmp_path / "out/cases.csv").read_text().splitlines())]
    for i in range(4):
        one = case.replace({"load.omega": omega[i], "lower.density": density[i]})
        ends = {n.name: n.value for n in key_numbers(rw.simulate(one, MPI.COMM_SELF))}
        for name, key in KEY_NUMBERS.items():
            assert float(data[name][i]) == pytest.approx(ends[key], rel=1e-4)
            assert float(rows[i][name]) == float(data[name][i])
    assert data.mass_lost_lower.attrs["units"] == "mg"
    out = tmp_path / "out.csv"
    assert main(["export", str(tmp_path / "out"), "-o", str(out)]) == 0
    (row, *_) = csv.DictReader(out.read_text().splitlines())
    assert row["load.omega (rad/s)"] == "1.0"
    assert float(row["mass_lost_lower (mg)"]) == float(data.mass_lost_lower[0])
