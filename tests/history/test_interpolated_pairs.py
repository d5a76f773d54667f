"""Compliances between nodes in the numbers of layers, and histories of several pairs together."""

import numpy as np
import pytest
from mpi4py import MPI
from parts import computed

import ringwear_par as rw
from ringwear_par.history.derivatives.elastic_numbers import compliance_change
from ringwear_par.history.elastic.bodies import young
from ringwear_par.history.elastic.interpolated_pairs import TOLERANCE, interpolate
from ringwear_par.history.elastic.pairs import assemble

CASE = {
    "lower.r": [20.0, 40.0], "lower.z": [0.0, 20.0], "lower.young": 1e4, "lower.poisson": 0.3,
    "lower.layers": [{"thickness": 0.05, "young": 1e5, "poisson": 0.3,
                      "wear": {"law": "threshold", "k": 5e-8, "p0": 20.0}}],
    "upper.r": [28.5, 31.5], "upper.z": [20.0, 40.0], "upper.young": 1e5, "upper.poisson": 0.3,
    "wear.lower.law": "archard", "wear.lower.k": 1e-7,
    "contact.friction": 0.1, "load.pressure": 50.0, "load.omega": 3.5,
    "time.scheme": "adaptive", "time.end": 100.0, "mesh.contact_elements": 16,
}  # fmt: skip
LAYER = "lower.layers[0]"
BOUNDS = {f"{LAYER}.thickness": (0.02, 0.1), f"{LAYER}.young": (5e4, 3e5)}
MOST = 1000


@pytest.fixture(scope="module")
def case():
    return rw.read_case(nested(CASE))


def nested(flat):
    """Return the tables of a case from dotted keys."""
    tables = {}
    for key, value in flat.items():
        name, _, last = key.rpartition(".")
        tables.setdefault(name, {})[last] = value
    return tables


def at(case, thickness, modulus):
    return case.replace({f"{LAYER}.thickness": thickness, f"{LAYER}.young": modulus})


def assembled(case):
    return assemble(case, MPI.COMM_SELF, use_kept=False)


@pytest.fixture(scope="module")
def interpolated(case, comm):
    return interpolate(case, assembled(case), BOUNDS, MOST, comm)


def test_compliances_are_as_close_as_they_say(case, interpolated):
    rng = np.random.default_rng(1)
    assert interpolated.error <= TOLERANCE
    for t, e in np.exp(rng.uniform(*np.log([*BOUNDS.values()]).T, (4, 2))).tolist():
        there = at(case, t, e)
        between, exact = interpolated.of(there), assembled(there)
        assert between.key == exact.key
        largest = np.abs(exact.normal[0]).max()
        assert np.abs(between.normal[0] - exact.normal[0]).max() <= 2.0 * TOLERANCE * largest
        np.testing.assert_array_equal(between.normal[1], exact.normal[1])
        for name in ("twist", "force_reaction", "torque_reaction"):
            np.testing.assert_allclose(
                getattr(between, name), getattr(exact, name), rtol=5.0 * TOLERANCE
            )


@pytest.mark.parametrize(
    ("key", "value"),
    [(f"{LAYER}.thickness", 0.04), (f"{LAYER}.young", 1.3e5), ("lower.young", 1e4)],
)
def test_derivatives_are_those_of_the_interpolation(case, interpolated, key, value):
    there = at(case, 0.04, 1.3e5)
    change = compliance_change(there, interpolated.of(there), key).normal
    step = 1e-5 * value
    more, less = (
        interpolated.of(moved).compliance(young(moved)).collocated
        for moved in (there.replace({key: value + by}) for by in (step, -step))
    )
    differences = (more - less) / (2.0 * step)
    assert np.abs(change - differences).max() <= 1e-6 * np.abs(differences).max()


def test_what_costs_more_than_it_saves_is_not_interpolated(case, comm):
    pair, thickness = assembled(case), f"{LAYER}.thickness"
    assert interpolate(case, pair, {"wear.lower.k": (1e-9, 1e-5)}, MOST, comm) is None
    assert interpolate(case, pair, BOUNDS, 20, comm) is None
    for bounds in ((1e-5, 1.0), (5.0, 50.0)):  # no layer is thicker than its body
        assert interpolate(case, pair, {thickness: bounds}, MOST, comm) is None


def test_histories_of_several_pairs_step_together_as_alone(case, interpolated):
    """Also where layers of other thicknesses are worn through."""
    thin = case.replace({"lower.layers[0].wear.k": 2e-6})
    cases = [at(thin, t, e) for t, e in ((0.021, 2e5), (0.03, 6e4), (0.08, 2e5))]
    pairs = [interpolated.of(there) for there in cases]
    times = [np.linspace(0.0, 100.0, 41)[1:].tolist()] * len(cases)
    (together,) = computed(cases, pairs, results=True, step_times=times)
    results = dict(zip(together.numbers, together.results(), strict=True))
    depths = [results[i].profiles["wear_lower"][-1].max() for i in range(len(cases))]
    assert depths[0] > 0.021
    assert depths[-1] < 0.08
    for i, there in enumerate(cases):
        (alone,) = computed([there], pairs[i], results=True, step_times=times[:1])
        (result,) = alone.results()
        for name, values in {**result.histories, **result.profiles}.items():
            found = {**results[i].histories, **results[i].profiles}[name]
            size = np.abs(values).max(initial=1e-6)
            np.testing.assert_allclose(found, values, rtol=0.0, atol=1e-9 * size, err_msg=name)
