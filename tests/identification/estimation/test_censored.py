"""Readings of which only a limit is known: their likelihood, derivatives, and what fits make."""

import copy

import numpy as np
import pytest
from laboratory import (
    CASE,
    END,
    TRUTH,
    fit_tables,
    history,
    one_test,
    penetration,
    write_table,
)
from mpi4py import MPI
from parts import parse_toml
from scipy.stats import norm

import ringwear_par as rw
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.model.histories import Histories
from ringwear_par.identification.model.noise import censored_rows

K = "wear.lower.k"


def test_rows_have_gradient_and_curvature_of_the_likelihood():
    """Central differences of twice the negative log likelihood; nothing overflows far away."""
    r, step = np.array([-3.0, -0.4, 0.0, 1.3, 5.0]), 1e-4
    for side in (-1, 1):
        sides = np.full(5, side)
        low, here, high = (-2.0 * norm.logcdf(side * (r + d)) for d in (-step, 0.0, step))
        residual, factor, root, slope = censored_rows(sides, r)
        assert root**2 == pytest.approx(here, rel=1e-9)
        assert 2.0 * root * slope == pytest.approx((high - low) / (2 * step), rel=1e-5)
        assert 2.0 * residual * factor == pytest.approx((high - low) / (2 * step), rel=1e-5)
        assert 2.0 * factor**2 == pytest.approx((high - 2 * here + low) / step**2, abs=1e-5)
        with np.errstate(all="raise", under="ignore"):
            far = np.array(censored_rows(np.full(2, side), np.array([-60.0, 60.0])))
        assert np.isfinite(far).all()


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """A record whose sensor ends at 2 um: later readings say that the depth is more."""
    folder = tmp_path_factory.mktemp("limits")
    (folder / "case.toml").write_text(CASE)
    t, z = penetration(history(80.0), np.random.default_rng(7), offset=0.0, drift=0.0)
    z *= 1e3
    table = list(zip(t, np.minimum(z, 2.0), np.where(z > 2.0, "above", ""), strict=True))
    lines = ["t_s,z_um,limit", *(f"{a:.9g},{b:.9g},{c}" for a, b, c in table)]
    (folder / "z.csv").write_text("\n".join(lines) + "\n")
    write_table(folder / "few.csv", ("t_s", "z_um"), t[z < 2.0], z[z < 2.0])
    record = {
        "quantity": "penetration", "file": str(folder / "z.csv"), "sd": 0.2, "censored": "limit",
        "columns": {"time": "t_s", "value": "z_um"},
    }  # fmt: skip
    known = {"wear.lower.p0": 25.0}
    found = fit_tables(folder, [one_test("a", 80.0, record, **known)])
    del found["fit"]["parameters"]["wear.lower.p0"]
    return found


def test_limits_of_a_record(tables):
    outcome = rw.fit(tables, MPI.COMM_SELF).to_dict()
    record = outcome["experiments"]["a"]["penetration"]
    assert 20 < record["censored"] < record["n"] == 50
    assert outcome["degrees_of_freedom"] == 50 - record["censored"] - 1
    k = outcome["parameters"][K]
    assert k["interval"][0] < TRUTH[K] < k["interval"][1]
    assert outcome["p_value"] > 1e-3
    # scatter that is next to none: limits count as much
    mixed = copy.deepcopy(tables)
    mixed["fit"]["parameters"][K] = {**mixed["fit"]["parameters"][K], "scatter": 1e-6}
    assert rw.fit(mixed, MPI.COMM_SELF).aic == pytest.approx(outcome["aic"], abs=0.05)
    few = copy.deepcopy(tables)
    data = few["experiment"][0]["data"][0]
    del data["censored"]
    data["file"] = data["file"].replace("z.csv", "few.csv")
    without = rw.fit(few, MPI.COMM_SELF).to_dict()["parameters"][K]
    assert k["sd"] < without["sd"]


def weighed(tables, scale, *sides):
    """Return a fit file of weighings of 1 mg that are limits."""
    light = copy.deepcopy(tables)
    light["fit"]["parameters"][K]["scale"] = scale
    light["experiment"][0]["data"] = [
        {"quantity": "mass.lower", "value": 1.0, "unit": "mg", "density": 7.8e-3, "sd": 0.05,
         "censored": side} for side in sides
    ]  # fmt: skip
    return light


@pytest.mark.parametrize(("side", "scale"), [("below", "log"), ("above", "linear")])
def test_limits_alone_bound_one_side(tables, side, scale):
    """A weighing below what the balance resolves, or above what it bears."""
    light = weighed(tables, scale, side)
    fit = rw.fit(light, MPI.COMM_SELF)
    k, place, words = fit.to_dict()["parameters"][K], side == "below", fit.summary()
    assert (k["verdict"], k["interval"][1 - place], k["sd"]) == ("at bound", None, None)
    said = f"{'less' if place else 'more'} than {k['interval'][place]:.5g} 1/MPa (95 %, like"
    assert f"wear.lower.k  {said}lihood profile)  at bound" in words
    assert "all readings are limits, which have no chi2" in words
    assert "mass.lower: 1 limit\n" in words
    assert [doubt.code for doubt in fit.doubts] == ["at-bound"]
    # twice the log likelihood is 2.71 less, where the probability is 0.26
    off = -0.05 * norm.ppf(np.exp(-0.5 * 2.7055)) * (1 if place else -1)
    assert mass_at(light, k["interval"][place]) == pytest.approx(1.0 + off, rel=0.005)


def mass_at(tables, k):
    """Return the mass (mg) that is lost at a k."""
    histories = Histories(read_fit(tables), MPI.COMM_SELF)
    return histories.responses(np.array([[k]]))[0][0, 0] * 1e3


def test_limits_on_both_sides(tables):
    """Of one weighing they are an interval with two ends; the model is on neither's wrong side."""
    both = weighed(tables, "log", "below", "above")
    fit = rw.fit(both, MPI.COMM_SELF)
    k = fit.to_dict()["parameters"][K]
    assert k["verdict"] == "identified"
    assert fit.doubts == ()
    # of equal probabilities; product of both is 3.84 less in twice its logarithm
    for end, sign in zip(k["interval"], (-1.0, 1.0), strict=True):
        t = (mass_at(both, end) - 1.0) / 0.05
        assert sign * t > 0.0
        lost = -2.0 * (norm.logcdf(t) + norm.logcdf(-t) - 2.0 * norm.logcdf(0.0))
        assert lost == pytest.approx(3.84, rel=0.03)
    both["experiment"][0]["data"][0]["value"] = 0.4  # at most 0.4, at least 1
    (*_, doubt) = [d for d in rw.fit(both, MPI.COMM_SELF).doubts if d.code == "outliers"]
    assert "the model is on the wrong side of 1 limit, by up to" in doubt.text
    both["fit"]["parameters"][K]["scatter"] = 0.1
    with pytest.raises(rw.InputError, match="limits"):
        read_fit(both)


def coated(tables, value, **changes):
    """Return a fit file of a coating of 2 um, of which is known when it is through."""
    found = copy.deepcopy(tables)
    base = parse_toml(CASE, "case")
    base["lower"]["layers"] = [{"thickness": 2e-3, "young": 1e5, "poisson": 0.3,
                                "wear": {"law": "archard", "k": 3e-9}}]  # fmt: skip
    found["case"] = base
    found["fit"]["parameters"] = {
        "lower.layers[0].wear.k": {"start": 3e-9, "bounds": [1e-10, 1e-7], "scale": "log"},
    }
    found["experiment"][0]["data"] = [
        {"quantity": "through.lower", "value": value, "unit": "s", "sd": 1.0, **changes}
    ]
    return found


@pytest.mark.parametrize("k", [2e-9, 2e-8])
def test_when_a_layer_is_through(tables, k):
    """Before the end and after it: where the history is through, and derivatives."""
    problem = read_fit(coated(tables, 90.0))
    histories = Histories(problem, MPI.COMM_SELF)
    points = np.array([[k], [k * 1.0001], [k * 0.9999]])
    found, up, down = histories.responses(points)
    assert found[0, 1] == pytest.approx((up - down)[0, 0] / (2e-4 * k), rel=2e-2)
    case = problem.experiments[0].case.replace(
        {"lower.layers[0].wear.k": k, "time.end": 300.0, "time.tolerance": 1e-7,
         "output.every": 1, "output.profiles": "all"}
    )  # fmt: skip
    result = rw.simulate(case, MPI.COMM_SELF)
    most = result.profiles["wear_lower"].max(axis=1)
    reached = np.interp(2e-3, most, result.histories["time"][-len(most) :])
    assert found[0, 0] == pytest.approx(reached, rel=0.05)


def test_a_layer_that_is_not_through(tables):
    outcome = rw.fit(coated(tables, END, censored="above"), MPI.COMM_SELF).to_dict()
    k = outcome["parameters"]["lower.layers[0].wear.k"]
    assert (k["verdict"], k["interval"][0]) == ("at bound", None)
    # of the time at the limit
    problem = read_fit(coated(tables, END))
    responses = Histories(problem, MPI.COMM_SELF).responses(np.array([[k["interval"][1]]]))
    assert responses[0][0, 0] == pytest.approx(END + norm.ppf(np.exp(-0.5 * 2.7055)), abs=0.2)
