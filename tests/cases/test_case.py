"""Case files: what is read."""

import math

import numpy as np
import pytest
from parts import ThresholdLaw, main, operator_key
from paths import PAPER

from ringwear_par.cases.files.reading import parse_case, read_case
from ringwear_par.cases.schema import KEYS

TEXT = PAPER.read_text()


def test_the_papers_case():
    case = read_case(PAPER)
    assert case.contact == (28.5, 31.5)
    assert case.load.force == pytest.approx(80 * math.pi * (31.5**2 - 28.5**2))
    assert case.wear_lower == ThresholdLaw(1e-7, 40.0)
    assert case.wear_upper is None
    assert (case.mesh.contact_elements, case.time.scheme) == (64, "implicit")
    assert case.text == TEXT


def test_overrides_enter_the_text_that_is_stored():
    title = 'a "quoted"\\ \t\r\n \u00b5m'
    case = read_case(PAPER, {"load.force": 100, "title": title, "output.fields": ["pressure"]})
    assert (case.load.force, case.title, case.output.fields) == (100, title, ("pressure",))
    assert parse_case(case.text, "stored") == case


def test_rings_need_not_touch():
    apart = read_case(PAPER, ["upper.z=[21, 40]"])
    assert apart.initial_gap == pytest.approx(1.0)
    assert apart.interpenetration == 0.0
    deep = read_case(PAPER, ["upper.z=[19.75, 40]"])
    assert deep.interpenetration == pytest.approx(0.25)
    assert deep.initial_gap.max() == pytest.approx(-0.25)
    assert read_case(PAPER, ["upper.z=[19.9999999999, 40]"]).interpenetration == 0.0


def test_shapes_give_the_initial_gap():
    case = read_case(PAPER, ["upper.chamfer=[0.2, 0.1]"])
    r = case.line.r
    exact = np.maximum(0, np.maximum(28.7 - r, r - 31.4))
    assert case.initial_gap == pytest.approx(exact, abs=1e-13)
    assert case.area == pytest.approx(math.pi * (31.5**2 - 28.5**2))
    case = read_case(PAPER, [
        "lower.profile=[[20.0000000001, 19], [30, 20], [40, 18]]",
        "upper.profile=[[28.5, 21], [31.5, 20.5]]", "mesh.contact=[29, 31.5000000001]",
    ])  # fmt: skip
    r = case.line.r
    lower = np.where(r < 30, 19 + (r - 20) / 10, 20 - 0.2 * (r - 30))
    assert case.initial_gap == pytest.approx(21 - (r - 28.5) / 6 - lower, abs=1e-9)
    assert case.contact == (29, 31.5)
    assert case.open_ends == (True, False)
    assert 30.0 in case.line.edges
    assert case.area == pytest.approx(math.pi * (31.5**2 - 28.5**2))


def test_nothing_cut_off_is_a_flat_face():
    plain = read_case(PAPER)
    for override in (
        "upper.chamfer=0", "upper.profile=[[28.5, 20], [31.5, 20]]",
        "lower.profile=[[20, 20], [30, 20], [40, 20]]",
    ):  # fmt: skip
        case = read_case(PAPER, [override])
        assert operator_key(case) == operator_key(plain)
        assert hash(operator_key(case)) == hash(operator_key(plain))
    updated = read_case(PAPER, ["mesh.geometry=updated", "mesh.geometry_tolerance=0.01"])
    assert operator_key(updated) == operator_key(plain)
    assert operator_key(read_case(PAPER, ["upper.chamfer=0.1"])) != operator_key(plain)


def test_the_schema_lists_every_key_or_those_with_a_word(capsys):
    assert main(["info", "--schema", "case"]) == 0
    every = capsys.readouterr().out.split()
    assert {key.path for key in KEYS} <= {*every}
    assert main(["info", "--schema", "case", "Wear.Lower"]) == 0
    some = capsys.readouterr().out.split()
    assert "wear.lower.k" in some
    assert "upper.young" not in some
