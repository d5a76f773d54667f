"""Layers in case files: what is read, set and varied of them, and a sentence for what is wrong."""

import numpy as np
import pytest
from paths import CASES

import ringwear_par as rw
from ringwear_par.cases.case import RingLayer
from ringwear_par.cases.files.reading import parse_case
from ringwear_par.elasticity.sections import Material
from ringwear_par.history.elastic.bodies import bodies, operator_key
from ringwear_par.history.refusals.cases import check_mesh
from ringwear_par.wear.laws.archard import ArchardLaw
from ringwear_par.wear.laws.threshold import ThresholdLaw
from ringwear_par.wear.layered import LayeredLaw, NoWear

CASE = CASES / "wear_through.toml"
TEXT = CASE.read_text()
K = "lower.layers[0].wear.k"


def test_layers_are_read_with_their_units():
    case = rw.read_case(CASE)
    assert case.lower.layers == (RingLayer(0.003, 1e5, 0.3, ThresholdLaw(2e-8)),)
    assert case.upper.layers == ()
    body = bodies(case)[0]
    assert (body.section.layers, body.layers) == ((0.003,), (Material(1e5, 0.3),))
    assert operator_key(case) != operator_key(case.replace({"lower.layers[0].thickness": 0.004}))
    law = case.laws[0]
    assert isinstance(law, LayeredLaw)
    assert law.laws == (ThresholdLaw(2e-8), ThresholdLaw(1e-7))
    assert parse_case(case.text, "stored") == case
    np.testing.assert_array_equal(case.layer_ends(0), np.full((1, case.line.n), 0.003))


def test_entries_of_layers_are_set_one_by_one():
    case = rw.read_case(CASE, [f"{K}=3e-8", "lower.layers[0].thickness='5 um'"])
    assert case.lower.layers[0] == RingLayer(0.005, 1e5, 0.3, ThresholdLaw(3e-8))
    assert case.replace({K: "4e-5 mm3/(N m)"}).lower.layers[0].wear == ThresholdLaw(4e-8)
    other = case.replace({"lower.layers[0].wear.law": "archard"})  # its p0, if any, goes
    assert other.lower.layers[0].wear == ArchardLaw(3e-8)
    as_body = case.replace({"lower.layers[0].wear": None})
    assert as_body.lower.layers[0].wear is None
    assert as_body.laws[0].laws == (ThresholdLaw(1e-7), ThresholdLaw(1e-7))
    assert case.replace({"lower.layers": None}).lower.layers == ()
    assert parse_case(other.text, "stored") == other


def test_layers_have_densities_of_their_own():
    case = rw.read_case(CASE, {"lower.density": 7.85e-3})
    assert case.lower.densities == (None, 7.85e-3)
    dense = case.replace({"lower.layers[0].density": "1.2 g/cm3"})
    assert dense.lower.densities == (1.2e-3, 7.85e-3)
    assert operator_key(dense) == operator_key(case)
    assert parse_case(dense.text, "stored") == dense
    assert case.upper.densities == (None,)


def test_a_layer_may_wear_on_a_body_that_does_not():
    case = rw.read_case(CASE, {"wear.lower": None, "wear.lower.law": None, "wear.lower.k": None})
    assert case.laws[0].laws == (ThresholdLaw(2e-8), NoWear())


WRONG = {
    "thickness=0": "--set lower.layers[0].thickness = 0: must be a finite number > 0 (mm)",
    "thickness=-1": "--set lower.layers[0].thickness = -1: must be a finite number > 0 (mm)",
    "thickness=20": "case.toml with --set: lower.layers: are 20 mm thick together; must be less "
    "than the 20 mm of lower",
    "thickness='3 s'": '--set lower.layers[0].thickness = "3 s": must be a finite number > 0 (mm) '
    "(s is no unit of mm)",
    "poisson=0.5": "--set lower.layers[0].poisson = 0.5: must be a number > -1 and < 0.5",
    "young=0": "--set lower.layers[0].young = 0: must be a finite number > 0 (MPa)",
    "thick=1": "--set lower.layers[0].thick: unknown key (did you mean thickness?)",
    "colour=1": "--set lower.layers[0].colour: unknown key; must be thickness, young, poisson, "
    "density, wear",
    "density=0": "--set lower.layers[0].density = 0: must be a finite number > 0 (g/mm^3)",
    "wear=1": "--set lower.layers[0].wear = 1: must be a table of a law",
    "wear.k=-1": "--set lower.layers[0].wear.k = -1: must be a finite number >= 0, or a table "
    "[[t, value], ...] in time, t in s and increasing, or a profile { r = [[r, value], ...] },"
    " r in mm and increasing (1/MPa)",
    "wear.law='treshold'": '--set lower.layers[0].wear.law = "treshold": must be "threshold" or '
    '"archard" or "power" or "table" or "running-in" (did you mean "threshold"?)',
    "wear={ law = 'non-local', k = 1e-7, length = 0.1 }": "--set lower.layers[0].wear.law = "
    '"non-local": must be "threshold" or "archard" or "power" or "table" or "running-in"',
    "wear={ law = 'user', file = 'a.py' }": '--set lower.layers[0].wear.law = "user": must be '
    '"threshold" or "archard" or "power" or "table" or "running-in"',
    "wear={ law = 'threshold', K = 1e-7 }": "--set lower.layers[0].wear.K: unknown key (did you "
    "mean wear.k?)",
    "wear.law='user'": '--set lower.layers[0].wear.law = "user": must be "threshold" or "archard" '
    'or "power" or "table" or "running-in"',
    "wear.m=2": "case.toml: lower.layers[0].wear.m: has no meaning where lower.layers[0].wear.law "
    '= "threshold"; must be among k, p0 (m is of law = "power")',
}


@pytest.mark.parametrize("setting", WRONG)
def test_a_sentence_for_a_wrong_layer(setting):
    with pytest.raises(rw.InputError) as caught:
        parse_case(TEXT, "case.toml", [f"lower.layers[0].{setting}"])
    assert list(caught.value.faults) == [WRONG[setting]]


def test_a_text_may_begin_like_a_list():
    assert parse_case(TEXT, "case.toml", ["title=[draft"]).title == "[draft"


def test_sentences_for_layers_that_do_not_fit_their_body():
    def told(*settings):
        with pytest.raises(rw.InputError) as caught:
            parse_case(TEXT, "case.toml", settings)
        return str(caught.value)

    assert told("lower.layers[1].young=1") == (
        "--set lower.layers[1].young = 1: the case has no such layer; must be of lower.layers[0]"
    )
    assert "lower.layers = 3: must be a list of at most 1000 tables" in told("lower.layers=3")
    many = told("lower.layers=[" + "{ thickness = 0.1 }, " * 1001 + "]")
    assert "[[lower.layers]] for each of them (there are 1001 of them)" in many
    assert "\n" not in many
    missing = told("lower.layers=[{ thickness = 0.1 }]")
    assert "lower.layers[0].young is missing: must be a finite number > 0 (MPa)" in missing
    assert "lower.layers[0].poisson is missing" in missing
    crown = told("lower.profile={ crown = 1000.0 }")
    assert "the contact face of lower recedes by 0.05" in crown
    assert "must be more than that, so that it stays within the top layer" in crown
    fits = parse_case(
        TEXT, "case.toml", ["lower.profile={ crown = 1000.0 }", "lower.layers[0].thickness=0.1"]
    )
    ends = fits.layer_ends(0)  # from the contact plane, so less is left where the face recedes
    np.testing.assert_allclose(
        ends[0] - 0.1, fits.sections[0].depth(fits.line.gap_point), atol=1e-15
    )
    layer = "{ thickness = 0.1, young = 1e5, poisson = 0.3 }"
    chamfer = told(f"upper.layers=[{layer}]", "upper.chamfer=0.2")
    assert "upper.layers[0].thickness = 0.1: the contact face of upper recedes by 0.2 mm" in chamfer
    assert 'wear.lower.law = "non-local": averages' in told(
        "wear.lower.law=non-local", "wear.lower.length=0.1"
    )


@pytest.mark.parametrize(
    ("thickness", "said"),
    [
        (1e-9, "lower.layers[0].thickness = 1e-09: the shortest element on its side is"),
        (19.9999999999, "lower.layers: leave 1.0e-10 mm of lower itself: the shortest element"),
    ],
)
def test_layers_that_drown_in_round_off_are_refused(thickness, said):
    case = rw.read_case(CASE, {"lower.layers[0].thickness": thickness})
    with pytest.raises(rw.InputError) as caught:
        check_mesh(case, "case.toml")
    assert str(caught.value).startswith(f"case.toml: {said}")
    assert str(caught.value).endswith("must be at least 4.0e-10 mm")
