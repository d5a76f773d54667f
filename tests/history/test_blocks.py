"""Histories of a block: the same in any company but for round-off, and when some of them fail."""

import numpy as np
import pytest
from parts import computed, results_of
from paths import CASES, PAPER
from tracing import ALONE

import ringwear_par as rw

BASE = {
    "mesh.contact_elements": 16, "mesh.grading": 1.0, "time.scheme": "adaptive", "time.end": 60.0,
}  # fmt: skip
FIXED = {"time.end": None, "time.steps": 8}
IMPLICIT = {**FIXED, "time.scheme": "implicit", "time.step": 2.0}
EXPLICIT = {**FIXED, "time.scheme": "explicit", "time.step": 0.05}
CROWN = [[float(r), float(20.0 + (r - 30.0) ** 2 / 40.0)] for r in np.linspace(28.5, 31.5, 13)]
CONES = {"lower.z": [0.0, 21.0], "lower.profile": [[20.0, 19.0], [40.0, 21.0]],
         "upper.z": [19.7, 40.0], "upper.profile": [[28.5, 19.85], [31.5, 20.15]]}  # fmt: skip
ARCHARD = {"wear.upper": {"law": "archard", "k": 1e-8}}
USER = """
import numpy as np

def rate(p, at):
    p0, k = at.parameters["p0"], at.parameters["k"]
    if np.any((p0 == 13.0) & (at.time > 5.0)):
        raise ValueError("no such material")
    if np.any((p0 == 17.0) & (at.time > 5.0)):
        return np.where(np.arange(len(p)) == 3, np.nan, k * p)
    grows = np.exp(at.wear / 1e-5) if np.any(p0 == 19.0) else 1.0
    return k * at.friction * at.speed * p * grows
"""


def law(name, **numbers):
    return {"wear.lower": {"law": name, **numbers}}


def thresholds(*numbers):
    return [law("threshold", k=k, p0=p0) for k, p0 in numbers]


THREE = thresholds((1e-8, 10.0), (4e-8, 0.0), (2e-7, 40.0))
#: changes of all histories, and those of each
COMPANIES = {
    "two bodies": (ARCHARD, THREE),
    "power": (EXPLICIT, [law("power", k=1e-10, m=m) for m in (1.3, 1.5)]),
    "memory": (IMPLICIT, [law("running-in", k=k, k_start=3.0 * k, depth=1e-3) for k in
                          (1e-8, 1e-7)]),
    "distance": (EXPLICIT, [law("running-in", k=1e-8, k_start=3e-8, distance=x) for x in
                            (100.0, 300.0)]),
    "non-local": ({}, [{**law("non-local", k=k, p0=10.0, length=0.3), "lower.young": young}
                       for k, young in ((1e-8, 3e3), (1e-7, 10e3), (4e-7, 30e3))]),
    "no wear": ({"wear.lower": None}, [{"load.pressure": p} for p in (20.0, 90.0)]),
    "forces in time": ({}, [{"load.pressure": [[0.0, p], [20.0, p], [21.0, x * p], [60.0, p]]}
                            for p, x in ((80.0, 0.2), (40.0, 1.5), (80.0, 0.0))]),
    "displacements": (
        {"load.control": "displacement", "load.pressure": None, "load.displacement": 0.1},
        [{"load.displacement": x} for x in
         (0.02, 0.05, [[0.0, 0.05], [30.0, 0.0], [50.0, 0.0], [60.0, 0.06]])],
    ),
    "speeds": ({}, [{"load.omega": x} for x in
                    (3.5, [[0.0, 0.0], [25.0, 4.0], [60.0, 1.0]], 0.5)]),
    "moduli": ({}, [{"lower.young": e, "upper.young": u} for e, u in
                    ((1e4, 1e5), (2e3, 2e5), (10240.123, 1e5), (1e4, 41234.56))]),
    "ends": ({}, [{"time.end": t, "time.tolerance": 1e-5 / t} for t in (1.0, 30.0, 200.0)]),
    "growing contact": ({"upper.profile": CROWN, **ARCHARD},
                        [{"load.pressure": p} for p in (1.6, 60.0, 300.0)]),
    "cones": ({**CONES, **IMPLICIT}, THREE),
    "times of output": ({}, [{**one, "output.times": t} for one, t in
                             zip(THREE, ([20.0], [7.0, 40.0], [60.0]), strict=True)]),
    "limits": (IMPLICIT, [{"stop.penetration": 1e-3}, {}, {"stop.energy": 9e6}]),
    "through layers": (
        {"lower.layers": [{"thickness": 3e-4, "young": 2e5, "poisson": 0.3,
                           "wear": {"law": "archard", "k": 2e-8}}]},
        [{"lower.layers[0].wear.k": k} for k in (1e-8, 4e-8, 1e-7)],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", COMPANIES)
def test_a_history_is_the_same_in_any_company(name):
    """To 1e-9 with fixed steps; with adaptive ones, and alone by TAO, within the tolerance."""
    common, own = COMPANIES[name]
    base = rw.read_case(PAPER, {**BASE, **law("threshold", k=2e-7, p0=10.0), **common})
    cases = [base.replace(changes) for changes in own]
    together, apart = results_of(cases, ALONE), results_of(cases, ALONE, batch=1)
    for case, one, other in zip(cases, together, apart, strict=True):
        assert np.array_equal(one.step, other.step)
        by_tao = rw.simulate(case, ALONE)
        tolerance = case.time.tolerance if case.time.adaptive else 1e-5
        for body in ("lower", "upper"):
            wear = one.profiles[f"wear_{body}"]
            size = max(wear.max(), 1e-6)
            np.testing.assert_allclose(wear, other.profiles[f"wear_{body}"], atol=1e-9 * size)
            exact = by_tao.profiles[f"wear_{body}"][-1]
            assert np.abs(wear[-1] - exact).max() < 0.1 * tolerance
        for variable, exact in other.histories.items():
            size = np.abs(exact).max(initial=1e-6)
            np.testing.assert_allclose(one.histories[variable], exact, atol=1e-8 * size)


def cones(slope):
    lower, upper = ([[r, 20.0 + slope * (r - 30.0)] for r in ends]
                    for ends in ((20.0, 40.0), (28.5, 31.5)))  # fmt: skip
    return {"lower.z": [0.0, lower[1][1]], "lower.profile": lower,
            "upper.z": [upper[0][1], 40.0], "upper.profile": upper}  # fmt: skip


COATED = {"young": 2e5, "poisson": 0.3}
#: of each of two cases, which have pairs of their own
PAIRS = {
    "heights": [{"upper.z": [20.0, z]} for z in (25.0, 40.0)],
    "cones": [cones(slope) for slope in (0.1, 1.0)],
    "coatings": [{"upper.layers": [{**COATED, "thickness": t}]} for t in (0.01, 0.3)],
    "open ends": [{"upper.r": [28.5, r], "mesh.contact": [28.5, 31.5]} for r in (31.5, 33.0)],
}  # fmt: skip


@pytest.mark.parametrize("name", PAIRS)
def test_cases_of_other_pairs_have_their_own_slopes_layers_and_ends(name):
    cases = [rw.read_case(PAPER, {**BASE, **IMPLICIT, **own}) for own in PAIRS[name]]
    parts, errors = computed(cases, {}, results=True)
    assert not errors
    assert len(parts) == (1 if name == "heights" else 2)
    found = {
        number: result
        for part in parts
        for number, result in zip(part.numbers, part.recorder.results(part.failures), strict=True)
    }
    for number, case in enumerate(cases):
        if name == "open ends" and number == 1:
            assert "reached the end of mesh.contact" in str(found[number])
            continue
        alone = rw.simulate(case, ALONE)
        for variable in ("torque", "worn_volume_lower", "dissipated_energy"):
            exact = alone.histories[variable]
            assert found[number].histories[variable] == pytest.approx(exact, rel=1e-3)


FAILURES = {
    "a law that raises": (
        {"law": "user", "parameters": {"k": 1e-8, "p0": 13.0}}, r"no such material.*step \d+",
    ),
    "a law that is no number": (
        {"law": "user", "parameters": {"k": 1e-8, "p0": 17.0}}, r"nan.*element 3.*step \d+",
    ),
    "wear that runs away": (
        {"law": "user", "parameters": {"k": 1e-8, "p0": 19.0}},
        r"nan at time .*; in step \d+|no step is short enough; in step \d+",
    ),
    "deep wear": ({"law": "threshold", "k": 3e-2, "p0": 0.0}, r"worn off lower.*; in step \d+"),
}  # fmt: skip


@pytest.mark.parametrize("name", FAILURES)
@pytest.mark.parametrize("scheme", [{}, IMPLICIT])
def test_one_that_fails_is_named_and_leaves_the_others_their_bits(tmp_path, name, scheme):
    bad, words = FAILURES[name]
    (tmp_path / "law.py").write_text(USER)
    sound = {"law": bad["law"], "k": 1e-8, "p0": 0.0}
    if bad["law"] == "user":
        bad = {**bad, "file": str(tmp_path / "law.py")}
        sound = {**bad, "parameters": {"k": 2e-8, "p0": 0.0}}
    base = rw.read_case(PAPER, {**BASE, **scheme, "wear.lower": sound})
    cases = [base.replace({"load.pressure": 40.0 + i}) for i in range(12)]
    known = results_of(cases, ALONE)
    cases[5] = cases[5].replace({"wear.lower": bad})
    for number, (one, other) in enumerate(zip(results_of(cases, ALONE), known, strict=True)):
        if number == 5:
            assert isinstance(one, rw.FailedResult)
            assert one.case == cases[5].text
            with pytest.raises(rw.ComputationError, match=words):
                raise one.error
            if scheme is IMPLICIT and bad["law"] == "user" and "away" not in name:
                assert "in step 3, from" in str(one.error)  # of the first bad numbers
            if "away" not in name:  # TAO would try for a minute
                with pytest.raises(rw.ComputationError, match=words):
                    rw.simulate(cases[5], ALONE)
        else:
            for field in ("wear_lower", "pressure"):
                assert np.array_equal(one.profiles[field], other.profiles[field])


def test_contact_at_an_open_end_and_bodies_that_overlap_fail_in_a_block():
    """Of four on the same elements: one is pressed too little for its overlap, one too much."""
    keys = {**BASE, **IMPLICIT, "mesh.contact": [29.0, 31.5], "lower.z": [0.0, 20.002]}
    base = rw.read_case(PAPER, {**keys, "upper.profile": [[r, z] for r, z in CROWN]})
    cases = [base.replace({"load.pressure": p}) for p in (0.1, 5.0, 6.0, 600.0)]
    texts = [str(getattr(one, "error", "")) for one in results_of(cases, ALONE)]
    assert "interpenetrate by 0.002 mm" in texts[0]
    assert texts[1:3] == ["", ""]
    assert "mesh.contact at r = 29 mm" in texts[3]


def test_a_sweep_of_wear_through_agrees_with_single_runs():
    base = rw.read_case(
        CASES / "wear_through.toml", {"mesh.contact_elements": 16, "time.end": 60.0}
    )
    layer = "lower.layers[0]"
    cases = [
        base.replace({f"{layer}.thickness": t, f"{layer}.wear.k": k, f"{layer}.wear.p0": p0})
        for t, k, p0 in ((3e-3, 1e-8, 0.0), (3e-4, 4e-8, 60.0), (2e-4, 3e-8, 100.0))
    ]
    for case, one in zip(cases, results_of(cases, ALONE), strict=True):
        exact, tolerance = rw.simulate(case, ALONE), case.time.tolerance
        off = one.profiles["wear_lower"][-1] - exact.profiles["wear_lower"][-1]
        assert np.abs(off).max() < tolerance
        through = one.attributes["time_through_lower"]
        assert through == pytest.approx(
            exact.attributes["time_through_lower"], rel=1e-3, nan_ok=True
        )
