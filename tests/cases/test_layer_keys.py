"""Layers in case files: what is read, set and varied of them."""

import numpy as np
from parts import NO_WEAR, ArchardLaw, Material, ThresholdLaw, bodies, operator_key
from paths import CASES

import ringwear_par as rw
from ringwear_par.cases.case import RingLayer
from ringwear_par.cases.files.reading import parse_case

CASE = CASES / "wear_through.toml"
K = "lower.layers[0].wear.k"


def test_layers_are_read_with_their_units():
    case = rw.read_case(CASE)
    assert case.lower.layers == (RingLayer(0.003, 1e5, 0.3, ThresholdLaw(2e-8)),)
    assert case.upper.layers == ()
    body = bodies(case)[0]
    assert (body.section.layers, body.layers) == ((0.003,), (Material(1e5, 0.3),))
    assert operator_key(case) != operator_key(case.replace({"lower.layers[0].thickness": 0.004}))
    assert case.laws[0] == (ThresholdLaw(2e-8), ThresholdLaw(1e-7))
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
    assert as_body.laws[0] == (ThresholdLaw(1e-7), ThresholdLaw(1e-7))
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
    assert case.laws[0] == (ThresholdLaw(2e-8), NO_WEAR)


def test_a_layer_ends_below_a_face_that_recedes():
    crown = {"lower.profile": {"crown": 1000.0}, "lower.layers[0].thickness": 0.1}
    case = rw.read_case(CASE, crown)
    left = case.layer_ends(0)[0]  # of the layer, from the contact plane
    np.testing.assert_allclose(left - 0.1, case.sections[0].depth(case.line.r), atol=1e-15)
