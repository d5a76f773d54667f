"""Doubts are of the worst state of a history, with its time: alone and among others."""

import tomllib

import pytest
from paths import CASES, PAPER

import ringwear_par as rw


def pressed(displacement):
    """Tables of the rings of the paper under a displacement, mm, in time, s."""
    tables = tomllib.loads(PAPER.read_text())
    return tables | {
        "load": {"control": "displacement", "displacement": displacement, "omega": 3.5},
        "wear": {"lower": {"law": "archard", "k": 1e-13}},
        "mesh": {"contact_elements": 16},
        "time": {"scheme": "implicit", "step": 20.0, "steps": 4},
    }


def crowned(force, **time):
    """Tables of a crown that begins with few elements in contact and wears to more of them."""
    tables = tomllib.loads((CASES / "crown.toml").read_text())
    return tables | {
        "load": {"control": "force", "force": force, "omega": 6.0},
        "mesh": {"contact_elements": 24, "grading": 1.0},
        "time": {"scheme": "implicit", "step": 20.0, "steps": 4, **time},
    }


def doubts(tables):
    return tuple(doubt.text for doubt in rw.simulate(rw.read_case(tables)).doubts)


def test_a_displacement_that_comes_and_goes_is_doubted_at_its_largest():
    moved, high = doubts(pressed([[0.0, 0.01], [40.0, 3.0], [80.0, 0.01]]))
    assert "3 mm at t = 40 s" in moved
    assert "mean pressure" in high
    assert "at t = 40 s" in high
    assert doubts(pressed([[0.0, 0.01], [40.0, 0.03], [80.0, 0.01]])) == ()


def test_fixed_steps_that_pass_over_a_corner_of_the_load_are_doubted():
    """A load that comes and goes between two ends of steps of 20 s is not seen."""
    peak = pressed([[0.0, 0.01], [25.0, 0.01], [30.0, 0.03], [35.0, 0.01]])
    force = crowned([[0.0, 5000.0], [30.0, 10000.0], [80.0, 5000.0]])
    for tables, words in ((peak, ("20 s", "t = 30 s", "0.03 mm", "0.01 mm")),
                          (force, ("t = 30 s", "10000 N", "8666.67 N"))):  # fmt: skip
        (missed,) = [text for text in doubts(tables) if "corner" in text]
        assert all(word in missed for word in words)
    at_ends = pressed([[0.0, 0.01], [20.0, 0.01], [40.0, 0.03], [60.0, 0.01]])
    adaptive = {**peak, "time": {"scheme": "adaptive", "end": 80.0}}
    assert doubts(at_ends) == doubts(adaptive) == ()


def test_few_elements_are_doubted_where_they_bear_load():
    """A crown's first contact is doubted, though it ends on all elements; a slight load is not."""
    (few,) = doubts(crowned(500.0))
    count = int(few.split()[0])
    assert 0 < count < 10
    assert "of 24 elements are in contact at t = 0 s, under 500 N" in few
    growing = crowned([[0.0, 5.0], [80.0, 500.0]])
    assert not any("at t = 0 s" in text for text in doubts(growing))


PAPERS = tomllib.loads(PAPER.read_text())
#: a soft disc under a stiff ring
DISC = {
    "lower": {"r": [0.0, 30.0], "z": [0.0, 1.4], "young": 500.0, "poisson": 0.3},
    "upper": {"r": [10.0, 20.0], "z": [1.4, 21.4], "young": 2e5, "poisson": 0.3},
    "load": {"control": "force", "force": 100.0, "omega": 1.0},
}


@pytest.mark.parametrize(
    ("tables", "elements", "poisson", "wrong"),
    [
        ({}, 64, None, False), (DISC, 32, None, True), (DISC, 64, None, False),
        ({}, 64, 0.3, False), ({}, 64, 0.499, True),
    ],
)  # fmt: skip
def test_asymmetric_compliances_are_doubted(tables, elements, poisson, wrong):
    """Of thin discs on coarse meshes, and of soft films that do not yield to volume."""
    tables = {**PAPERS, **tables, "mesh": {"contact_elements": elements}}
    tables["time"] = {"step": 1.0, "steps": 1}
    if poisson is not None:
        film = {"thickness": 0.02, "young": 10.0, "poisson": poisson}
        tables |= {"lower": {**tables["lower"], "layers": [film]}, "load": {**tables["load"]}}
        tables["load"]["pressure"] = 0.5
    result = rw.simulate(rw.read_case(tables))
    assert ("coarse_mesh" in codes(result)) == wrong
    limit = 3e-3 if poisson is None else 5e-3
    assert (limit < result.attributes["symmetry_defect"]) == wrong


def codes(result):
    return [doubt.code for doubt in result.doubts]


def test_doubts_of_a_history_are_as_alone():
    """A ring that never touches excuses what it makes of itself."""
    soft = {"layers": [{"thickness": 0.5, "young": 2.0, "poisson": 0.45}]}
    forces, displacements = (crowned(70.0), crowned(94.0)), (pressed(0.1), pressed(1.1))
    for tables in forces:
        tables["lower"] |= soft
        tables["upper"] |= {"profile": {"crown": 60.0}}
    for tables in displacements:
        tables["lower"] |= {"z": [-20.0, 19.85]}
    down = [pressed([[0.0, 0.01], [40.0, top], [80.0, 0.01]]) for top in (2.0, 3.0)]
    for pair, code in ((forces, "high_pressure"), (displacements, "large_displacement"),
                       (down, "large_displacement")):  # fmt: skip
        cases = [rw.read_case(tables) for tables in pair]
        alone = [codes(rw.simulate(case)) for case in cases]
        assert code in alone[0] + alone[1]
        assert [codes(result) for result in rw.simulate_all(cases)] == alone
