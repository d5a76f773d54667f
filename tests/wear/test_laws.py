"""Laws: rates by their formulas, slopes, many histories at once, layers and averages."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from parts import NO_WEAR, Table, in_words
from paths import PAPER
from wearing import (
    ArchardLaw,
    NonLocalLaw,
    PowerLaw,
    RunningInLaw,
    TableLaw,
    ThresholdLaw,
)

import ringwear_par as rw
from ringwear_par.wear.step import Elements

MU, P = 0.3, np.array([5.0, 20.0, 80.0])
R = np.array([10.0, 15.0, 20.0])
V, SLID = 4.0 * R, np.array([100.0, 200.0, 400.0])
WORN = np.array([0.0, 1e-3, 4e-3])
AT = rw.LocalState(2.0, R, V, MU, WORN, SLID)
POINTS = ((0.0, 0.0), (1000.0, 1e-5), (4000.0, 1e-4))
FALL = {"k": 1e-7, "k_start": 5e-7, "p0": 10.0}
OVER = MU * np.maximum(P - 10.0, 0.0) * V
#: keys of wear.lower, and their rate, mm/s
RATES = {
    "threshold": ({"k": 1e-7, "p0": 10.0}, 1e-7 * OVER),
    "threshold, in time": ({"k": [[0.0, 0.0], [4.0, 2e-7]], "p0": 10.0}, 1e-7 * OVER),
    "threshold, in r": ({"k": {"r": [[5.0, 0.0], [25.0, 2e-7]]}, "p0": 10.0},
                        1e-8 * (R - 5.0) * OVER),
    "non-local": ({"k": 1e-7, "p0": 10.0, "length": 0.3}, 1e-7 * OVER),
    "archard": ({"k": 1e-8}, 1e-8 * P * V),
    "power": ({"k": 1e-9, "m": 1.5, "n": 0.5}, 1e-9 * P**1.5 * V**0.5),
    "running-in": ({**FALL, "distance": 150.0}, (1e-7 + 4e-7 * np.exp(-SLID / 150.0)) * OVER),
    "running-in, depth": ({**FALL, "depth": 2e-3}, (1e-7 + 4e-7 * np.exp(-WORN / 2e-3)) * OVER),
    "table": ({"table": POINTS}, np.interp(P * V, [0, 1e3, 4e3, 8e3], [0, 1e-5, 1e-4, 2.2e-4])),
}  # fmt: skip


def law_of(name):
    keys = {key: [*map(list, v)] if key == "table" else v for key, v in RATES[name][0].items()}
    return rw.read_case(PAPER, {"wear.lower": {"law": name.partition(",")[0], **keys}}).wear_lower


def derivative(function, x, smallest):
    """By a one-sided difference of the second order, which needs nothing below x."""
    h = 1e-5 * np.maximum(x, smallest)
    return (4.0 * function(x + h) - 3.0 * function(x) - function(x + 2.0 * h)) / (2.0 * h)


@pytest.mark.parametrize("name", RATES)
def test_rates_and_slopes_are_those_of_the_formula(name):
    law, exact = law_of(name), RATES[name][1]
    assert law.rate(P, AT) == pytest.approx(exact, rel=1e-12)
    values = law.kind.function(P, AT, **law.at(AT))
    assert np.maximum(values[0], 0.0) == pytest.approx(exact, rel=1e-12)
    wears = values[0] > 0.0
    slope = derivative(lambda p: law.rate(p, AT), P, 1e-3)
    assert (values[1] * wears)[wears] == pytest.approx(slope[wears], rel=1e-9)
    assert (slope[~wears] == 0.0).all()
    assert law.remembers == (len(values) == 3) == (name == "running-in, depth")
    assert law.linear == (name.partition(",")[0] in ("threshold", "archard", "non-local")
                          or name == "running-in")  # fmt: skip
    if law.linear:
        further = law.kind.function(P + 7.0, AT, **law.at(AT))[0]
        assert further == pytest.approx(values[0] + 7.0 * values[1], rel=1e-12)
    assert law.breakpoints == ((4.0,) if name == "threshold, in time" else ())
    if law.remembers:
        by_wear = derivative(lambda wear: law.rate(P, replace(AT, wear=wear)), WORN, 1e-6)
        assert values[2] == pytest.approx(by_wear, rel=1e-8)


SIZES = np.array([1.0, 2.0, 5.0])
MANY = {
    "threshold": [ThresholdLaw(1e-7 * x, 9.0 * x) for x in SIZES],
    "archard": [ArchardLaw(1e-8 * x) for x in SIZES],
    "power": [PowerLaw(1e-9, 1.0 + 0.3 * x, 0.7) for x in SIZES],
    "table": [TableLaw(tuple((a, b * x) for a, b in POINTS)) for x in SIZES],
    "running-in, depth": [RunningInLaw(1e-7, 5e-7, 20.0, depth=1e-3 * x) for x in SIZES],
    "running-in, distance": [RunningInLaw(1e-7, 1e-7 * x, distance=9.0 * x) for x in SIZES],
}


@pytest.mark.parametrize("laws", MANY.values(), ids=MANY)
def test_each_of_many_histories_has_the_numbers_that_it_has_alone(laws):
    rng = np.random.default_rng(3)
    p, wear, slid = rng.uniform(0.0, 90.0, (3, 3)), rng.uniform(0.0, 2e-3, (3, 3)), SIZES * SLID
    time, speed, mu = SIZES[:, None], SIZES[:, None] * R, 0.1 * SIZES[:, None]
    at = rw.LocalState(time, R, speed, mu, wear, np.tile(slid, (3, 1)))
    assert len({law.key for law in laws}) == 1
    stacked = {
        name: np.array([np.atleast_1d(law.arguments[name]) for law in laws])
        for name in laws[0].arguments
    }
    together = laws[0].kind.function(p, at, **stacked)
    for i, law in enumerate(laws):
        own = rw.LocalState(time[i, 0], R, speed[i], mu[i, 0], wear[i], slid)
        for all_values, values in zip(
            together, law.kind.function(p[i], own, **law.at(own)), strict=True
        ):
            np.testing.assert_allclose(all_values[i], values, rtol=1e-13)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (ThresholdLaw(1e-7), ArchardLaw(1e-7)),
        (NonLocalLaw(1e-7, length=0.1), NonLocalLaw(1e-7, length=0.2)),
        (TableLaw(POINTS), TableLaw(POINTS[:2])),
        (RunningInLaw(1e-7, 2e-7, depth=1.0), RunningInLaw(1e-7, 2e-7, distance=1.0)),
        (NO_WEAR, ArchardLaw(0.0)),
    ],
)
def test_laws_that_no_block_has_together(one, other):
    assert one.key != other.key
    assert one != other


def test_worn_volume_by_energy():
    assert ThresholdLaw(1e-7).ratio(0.1) == 1e-7
    assert ThresholdLaw(1e-7, 1.0).ratio(0.1) == 0.0
    assert ThresholdLaw(Table((0.0, 9.0), (1e-7, 3e-7))).ratio(0.1) == 0.0
    assert ArchardLaw(1e-7).ratio(0.1) == pytest.approx(1e-6)
    assert ArchardLaw(1e-7).ratio(Table((0.0, 1.0), (0.1, 0.2))) == 0.0
    words = in_words([ArchardLaw(2e-8), ThresholdLaw(1e-7)], [1e-3])
    assert "1/MPa through a layer of 1 um, then k mu" in words
    assert words.endswith("in the body itself")


@pytest.mark.parametrize("law", ["threshold", "archard"])
def test_volume_by_energy_is_what_the_law_says(law):
    """Without a threshold it is k, by Archard's law k / mu; and the run has checked that."""
    keys = {"wear.lower": {"law": law, "k": 1e-8}, "contact.friction": MU}
    keys |= {"mesh.contact_elements": 16, "time.steps": 5}
    result = rw.simulate(rw.read_case(PAPER, keys), MPI.COMM_SELF)
    last = {name: values[-1] for name, values in result.histories.items()}
    ratio = 1e-8 if law == "threshold" else 1e-8 / MU
    assert last["worn_volume_lower"] == pytest.approx(ratio * last["dissipated_energy"], rel=1e-12)
    assert result.attributes["energy_identity"]
    assert result.balances["energy"] < 1e-12


def test_averages_keep_constants_and_volumes():
    r = np.linspace(28.5, 31.5, 40) ** 2 / 30.0
    area = 2 * np.pi * r * np.gradient(r)
    elements = Elements(r=r, area=area, obliquity=None)
    average = elements.average(0.4)
    assert average.sum(axis=1) == pytest.approx(np.ones(40), abs=1e-13)
    assert area @ average == pytest.approx(area, rel=1e-12)
    assert np.linalg.eigvalsh(area[:, None] * average).min() > -1e-12 * area.max()
    assert elements.average(1e-6) == pytest.approx(np.eye(40), abs=1e-12)
