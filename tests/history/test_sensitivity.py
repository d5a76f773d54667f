"""Tangent-linear histories: derivatives of what the program computes, its steps being given."""

import dataclasses

import numpy as np
import pytest
from mpi4py import MPI
from parts import D_HISTORIES, D_PROFILES, Recorder
from paths import CASES, PAPER

import ringwear_par as rw
from ringwear_par.history.derivatives.keys import differentiable
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.loop import simulate_one

ALONE = MPI.COMM_SELF
LAW = {"law": "threshold", "k": 1e-7, "p0": 10.0}
#: keys of laws of lower and upper
LAWS = {
    "threshold": (LAW, None),
    "two bodies": ({**LAW, "p0": 25.0}, {"law": "archard", "k": 1e-8}),
    "power": ({"law": "power", "k": 1e-9, "m": 1.3, "n": 0.8}, LAW),
    "table": ({"law": "table", "table": [[0.0, 0.0], [8e3, 2e-5], [2e4, 9e-5]]}, None),
    "memory": ({"law": "running-in", "k": 1e-7, "k_start": 3e-7, "p0": 9.0, "depth": 1e-3}, None),
    "distance": ({"law": "running-in", "k": 1e-7, "k_start": 3e-7, "distance": 100.0}, None),
    "non-local": ({**LAW, "law": "non-local", "length": 0.3}, {"law": "archard", "k": 2e-8}),
    "user": ({"law": "user", "file": "law.py", "parameters": {"k": 1e-7, "p1": 30.0}}, None),
}
STEPPINGS = {
    "adaptive": {"time.end": 30.0},
    "implicit": {"time.step": 4.0, "time.steps": 8},
    "explicit": {"time.step": 0.05, "time.steps": 8},
}
#: takes no complex numbers: derivatives are found by differences
USER = (
    "def rate(p, at):\n"
    "    k, p1 = at.parameters['k'], at.parameters['p1']\n"
    "    return float(k) * float(at.friction) * at.speed * p * (1.0 + p / float(p1))\n"
)
CROWN = [[float(r), float(20.0 + (r - 30.0) ** 2 / 40.0)] for r in np.linspace(28.5, 31.5, 13)]
VARYING = [[0.0, 40.0], [12.0, 0.0], [16.0, 0.0], [25.0, 60.0]]


def case_of(tmp_path, law="threshold", scheme="adaptive", elements=12, **changes):
    (tmp_path / "law.py").write_text(USER)
    keys = {"mesh.contact_elements": elements, "mesh.grading": 1.5, "time.scheme": scheme}
    for body, own in zip(("lower", "upper"), LAWS[law], strict=True):
        keys |= {f"wear.{body}.{name}": value for name, value in (own or {}).items()}
    if law == "user":
        keys |= {"wear.lower.file": str(tmp_path / "law.py")}
    # of more than four digits, so that its neighbours' compliances are of the same reference
    keys["lower.young"] = 10001.3
    return rw.read_case(PAPER, {**keys, **STEPPINGS[scheme], **changes})


def history(case, pair, keys=(), times=None):
    """The result of a history alone."""
    recorder = Recorder([case], ALONE, derivatives=keys)
    how = {"derivatives": keys, "step_times": times}
    simulate_one(case, ALONE, pair=pair, observers=[recorder], **how)
    return recorder.result()


def value_of(case, key):
    """The value of a number of a case."""
    load, (table, _, name) = case.load, key.rpartition(".")
    if key == "load.pressure":
        return load.force / case.area
    if table.startswith("wear"):
        body, _, more = key.removeprefix("wear.").partition(".")
        law = getattr(case, f"wear_{body}")
        return law.length if more == "length" else law.quantity(more)
    return case.friction if key == "contact.friction" else getattr(getattr(case, table), name)


def numbers_of(case):
    """Keys of numbers, each once: not the load in two units."""
    keys = [key for key in differentiable(case) if key != "load.force"]
    return {key: value_of(case, key) for key in keys if value_of(case, key) != 0.0}


def values(result):
    """All that results may have derivatives of, by the names of these."""
    stored = result.histories | result.profiles
    names = [name for name in (*D_HISTORIES, *D_PROFILES) if name.removeprefix("d_") in stored]
    return {name: stored[name.removeprefix("d_")] for name in names}


def ends_of(case, pair):
    """Ends of the steps of an adaptive history; None of others."""
    return history(case, pair).histories["time"][1:].tolist() if case.time.adaptive else None


def sizes(case, plain, keys):
    """By name (P,): what a derivative is if the variable is proportional to the number."""
    largest = {name: np.abs(there).max() for name, there in values(plain).items()}
    for name in ("d_gap", "d_penetration"):  # differences of larger ones
        largest[name] = max(largest.get(name, 0.0), largest["d_approach"])
    numbers = np.array([value_of(case, key) for key in keys])
    return {name: most / numbers for name, most in largest.items()}


def off_differences(case, pair, keys, times=None, step=1e-6):
    """Largest deviation from central differences, over the largest derivative of each variable.

    Less what round-off makes of differences.
    """
    times = ends_of(case, pair) if times is None else times
    there = history(case, pair, keys, times)
    noise = sizes(case, there, keys)
    worst = 0.0
    for row, key in enumerate(keys):
        h = step * value_of(case, key)
        up, down = (
            history(case.replace({key: value_of(case, key) + by}), pair, times=times)
            for by in (h, -h)
        )
        for name, slopes in there.derivatives.items():
            central = (values(up)[name] - values(down)[name]) / (2.0 * h)
            off = np.abs(slopes[row] - central).max() - 3e-13 / step * noise[name][row]
            if off > 0.0:
                worst = max(worst, off / np.abs(slopes[row]).max())
    return worst


@pytest.mark.parametrize(
    ("law", "scheme", "changes"),
    [
        ("threshold", "adaptive", {"upper.profile": CROWN}),
        ("memory", "implicit", {"upper.profile": CROWN}),
        ("power", "explicit", {"upper.profile": CROWN}),
        ("non-local", "implicit", {"upper.profile": CROWN}),
        ("two bodies", "adaptive", {"load.pressure": VARYING}),
        ("two bodies", "adaptive", {"contact.friction": [[0.0, 0.05], [12.0, 0.2]]}),
        ("threshold", "adaptive", {"load.control": "displacement", "load.displacement": 0.04}),
        ("distance", "implicit", {"load.control": "displacement", "load.displacement": 0.04}),
        ("two bodies", "adaptive", {"load.omega": VARYING, "upper.chamfer": 0.3}),
        ("threshold", "adaptive", {"output.times": [7.0, 21.0]}),
        ("user", "adaptive", {"lower.r": [29.0, 40.0]}),
        ("table", "explicit", {}),
    ],
)
def test_derivatives_are_central_differences(tmp_path, law, scheme, changes):
    """Partial contact, lift-off, stops, sloping faces, displacements, times of output."""
    case = case_of(tmp_path, law, scheme, elements=16, **changes)
    pair = assemble(case, ALONE)
    keys = list(numbers_of(case))
    times = None
    if case.output.times:
        times = ends_of(case.replace({"output.times": None}), pair)
    assert off_differences(case, pair, keys, times) < 1e-6


def test_elements_that_enter_within_steps_are_differentiated():
    case = rw.read_case(CASES / "crown.toml", {"mesh.contact_elements": 16})
    assert off_differences(case, assemble(case, ALONE), list(numbers_of(case))) < 1e-6


def test_objects_of_users_are_differentiated(tmp_path):
    @dataclasses.dataclass(frozen=True)
    class Own:
        k: float = 1e-7
        depth: float = 2e-3

        def rate(self, p, local):
            return self.k * np.exp(-local.wear / self.depth) * local.power * p

    case = dataclasses.replace(case_of(tmp_path, scheme="implicit"), wear_lower=Own())
    pair, keys = assemble(case, ALONE), ["wear.lower.k", "wear.lower.depth"]
    slopes = history(case, pair, keys).derivatives["d_wear_lower"]
    for slope, name in zip(slopes, ("k", "depth"), strict=True):
        h = 1e-5 * getattr(Own, name)
        up, down = (
            history(dataclasses.replace(case, wear_lower=Own(**{name: there})), pair)
            for there in (getattr(Own, name) + h, getattr(Own, name) - h)
        )
        central = (up.profiles["wear_lower"] - down.profiles["wear_lower"]) / (2.0 * h)
        np.testing.assert_allclose(slope, central, atol=1e-6 * np.abs(slope).max())


def test_steps_that_are_given(tmp_path):
    case, keys = case_of(tmp_path), ["wear.lower.k"]
    pair = assemble(case, ALONE)
    whole = history(case, pair, keys)
    ends = whole.histories["time"][1:].tolist()
    again = history(case, pair, keys, ends)
    np.testing.assert_allclose(again.derivatives["d_wear_lower"], whole.derivatives["d_wear_lower"],
                               rtol=1e-12, atol=1e-12)  # fmt: skip
    twice = sorted([*ends, *(0.5 * (a + b) for a, b in zip([0.0, *ends], ends, strict=False))])
    assert history(case, pair, (), twice).histories["time"][1:].tolist() == twice
    for wrong in (ends[:-1], [], ends[::-1]):
        with pytest.raises(ValueError, match="step_times"):
            history(case, pair, (), wrong)


def test_results_hold_derivatives(tmp_path, comm):
    case = case_of(tmp_path, **{"output.fields": ["wear_lower"]})
    keys = ["wear.lower.p0", "load.pressure"]
    result = rw.simulate(case, comm, derivatives=keys)
    one = rw.simulate(case, ALONE, derivatives=keys)
    for name, slopes in one.derivatives.items():
        there = result.derivatives[name]
        np.testing.assert_allclose(there, slopes, rtol=0, atol=1e-9 * np.abs(slopes).max())
    n, rows = case.line.n, len(result.step)
    assert result.derivatives["d_wear_lower"].shape == (2, rows, n)
    assert result.derivatives["d_approach"].shape == (2, rows)
    assert "d_pressure" not in result.derivatives
    assert not result.derivatives["d_penetration"][:, 0].any()
    volumes = result.derivatives["d_wear_lower"] @ case.line.area
    np.testing.assert_allclose(volumes, result.derivatives["d_worn_volume_lower"], rtol=1e-12)
    many = rw.simulate_all([case, case.replace({"wear.lower.k": 2e-7})], comm, derivatives=keys)
    for name, slopes in result.derivatives.items():
        size = max(np.abs(slopes).max(), 1e-3)
        np.testing.assert_allclose(many[0].derivatives[name], slopes, atol=1e-9 * size)


def test_files_hold_derivatives(tmp_path):
    case = case_of(tmp_path, scheme="implicit", **{"output.profiles": "last"})
    result = rw.simulate(case, ALONE, derivatives=["contact.friction", "wear.lower.k"])
    result.save(tmp_path / "run.h5")
    data = rw.open_result(tmp_path / "run.h5").to_xarray()
    assert data.equals(result.to_xarray())
    assert data["d_wear_lower"].sel(parameter="wear.lower.k").dims == ("element",)
    assert data["d_torque"].dims == ("parameter", "step")
    assert data["d_torque"].attrs["units"] == "N mm/parameter_unit"
    assert data["parameter_unit"].sel(parameter="wear.lower.k").item() == "1/MPa"
    plain = rw.simulate(case, ALONE)
    assert not plain.derivatives
    assert all(np.array_equal(plain.histories[n], v) for n, v in result.histories.items())


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (["wear.lower.kk"], "wear.lower.kk"), (["load.omega"], "load.omega"),
        (["wear.lower.k", "wear.lower.k"], "once"), ("wear.lower.k", "list"),
    ],
)  # fmt: skip
def test_derivatives_that_there_are_not(tmp_path, keys, words):
    case = case_of(tmp_path, **{"load.omega": VARYING})
    with pytest.raises(rw.InputError, match=words):
        rw.simulate(case, ALONE, derivatives=keys)
    (failed,) = rw.simulate_all([case], ALONE, derivatives=keys)
    assert words in str(failed.error)
    moving = case_of(tmp_path, **{"mesh.geometry": "updated"})
    with pytest.raises(rw.InputError, match=r"mesh\.geometry"):
        rw.simulate(moving, ALONE, derivatives=["wear.lower.k"])
