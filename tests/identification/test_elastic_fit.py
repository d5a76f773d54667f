"""Fits of numbers of which each value has an operator of its own: searches between exact ones."""

import numpy as np
import pytest
from mpi4py import MPI
from paths import CASES

import ringwear_par as rw
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.fit import fit
from ringwear_par.identification.model import histories as operators_room
from ringwear_par.identification.model.histories import Histories

ELEMENTS = 8
TRUTH = {
    "lower.layers[0].thickness": 0.06, "lower.layers[0].young": 8e4, "lower.layers[0].wear.k": 6e-8
}  # fmt: skip
#: narrow bounds need few nodes
START = {
    "lower.layers[0].thickness": {"start": 0.05, "bounds": [0.04, 0.09], "scale": "log"},
    "lower.layers[0].young": {"start": 1e5, "bounds": [5e4, 1.2e5], "scale": "log"},
    "lower.layers[0].wear.k": {"start": 1e-7, "bounds": [3e-8, 2e-7], "scale": "log"},
}
PRESSURES = 40.0, 85.0
#: mm, of all readings; readings of a record or a profile
SD, READINGS = 2e-5, 60


def write_readings(folder):
    """Write approaches and profiles of histories with known numbers, with noise."""
    rng = np.random.default_rng(1)
    t, r = np.linspace(2.0, 200.0, READINGS), np.linspace(28.6, 31.4, READINGS)
    for pressure in PRESSURES:
        keys = {"load.pressure": pressure, "mesh.contact_elements": ELEMENTS, **TRUTH}
        result = rw.simulate(rw.read_case(CASES / "coated.toml", keys), MPI.COMM_SELF)
        approach = np.interp(t, result.histories["time"], result.histories["approach"])
        depth = np.interp(r, result.line.r, result.profiles["wear_lower"][-1])
        for header, x, values in (("time / s", t, approach), ("r / mm", r, depth)):
            file = folder / f"{header[0]}_{pressure:g}.csv"
            noisy = np.c_[x, values + SD * rng.standard_normal(READINGS)]
            np.savetxt(file, noisy, "%.9g", ",", header=f"{header},value / mm", comments="")


def fit_tables(folder, keys, starts):
    """Return the fit file of two tests of a coating, as a dict."""
    experiments = [
        {"name": f"{pressure:g} MPa",
         "set": {"load.pressure": pressure, "mesh.contact_elements": ELEMENTS},
         "data": [
             {"quantity": quantity, "file": str(folder / f"{axis[0]}_{pressure:g}.csv"), "sd": SD,
              "columns": {axis: f"{axis} / {unit}", "value": "value / mm"}}
             for quantity, axis, unit in (("approach", "time", "s"), ("profile.lower", "r", "mm"))
         ]}
        for pressure in PRESSURES
    ]  # fmt: skip
    parameters = {key: START[key] for key in keys}
    return {"case": str(CASES / "coated.toml"), "experiment": experiments,
            "fit": {"parameters": parameters}}  # fmt: skip


@pytest.fixture
def tables(tmp_path):
    """A function that makes the fit file of a coating's thickness, modulus and k, as a dict."""
    if MPI.COMM_WORLD.rank == 0:
        write_readings(tmp_path)
    MPI.COMM_WORLD.barrier()
    return lambda starts, keys=tuple(START): fit_tables(tmp_path, keys, starts)


def numbers(result):
    """Return estimates and standard deviations, (2, keys)."""
    return np.array([[p.estimate, p.sd] for p in result.parameters]).T


def test_a_search_between_operators_ends_at_the_optimum_of_exact_ones(tables, comm, monkeypatch):
    keys = "lower.layers[0].thickness", "lower.layers[0].wear.k"
    between = fit(tables(2, keys), comm)
    assert between.n_at_best == len(between.starts) == 2
    assert all(start.converged for start in between.starts)
    monkeypatch.setattr(operators_room, "interpolate", lambda *_: None)
    exact = fit(tables(1, keys), comm)
    (estimates, sds), (expected, expected_sds) = numbers(between), numbers(exact)
    assert (np.abs(estimates - expected) <= 0.01 * expected_sds).all()
    np.testing.assert_allclose(sds, expected_sds, rtol=1e-3)
    assert between.chi2 == pytest.approx(exact.chi2, rel=1e-6)
    # the search itself was on rougher histories
    assert between.starts[0].optimum != exact.starts[0].optimum


def test_operators_between_others_are_those_of_a_search_only(tables, comm):
    """Whoever asks for readings without saying how gets exact ones."""
    problem = read_fit(tables(2))
    histories = Histories(problem, comm)
    point = 0.9 * np.array([list(problem.start.values())])
    (before,) = histories.responses(point)
    histories.operators.interpolate(comm)
    assert histories.operators.are_interpolated
    (after,) = histories.responses(point)
    (between,) = histories.responses(point, exact=False)
    np.testing.assert_array_equal(before, after)
    assert 0.0 < np.abs(between[:, 0] - before[:, 0]).max() < 1e-3 * before[:, 0].max()
