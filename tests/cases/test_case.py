"""Case files: what is read, and a sentence for everything that is wrong."""

import math
import re

import numpy as np
import pytest
from paths import PAPER

from ringwear_par.cases.files.reading import parse_case, read_case
from ringwear_par.cases.schema import KEYS
from ringwear_par.cases.tables import key_table
from ringwear_par.errors import InputError
from ringwear_par.history.elastic.bodies import operator_key
from ringwear_par.history.refusals.cases import check_mesh
from ringwear_par.identification.definition import schema as fits
from ringwear_par.studies.definition import schema as studies
from ringwear_par.wear.laws.threshold import ThresholdLaw

TEXT = PAPER.read_text()


def faults(text=TEXT, *overrides):
    with pytest.raises(InputError) as caught:
        parse_case(text, "case.toml", overrides)
    assert caught.value.exit_status == 2
    return list(caught.value.faults)


def test_the_papers_case():
    case = read_case(PAPER)
    assert case.contact == (28.5, 31.5)
    assert case.load.force == pytest.approx(80 * math.pi * (31.5**2 - 28.5**2))
    assert case.wear_lower == ThresholdLaw(1e-7, 40.0)
    assert case.wear_upper is None
    assert (case.mesh.contact_elements, case.time.scheme) == (64, "implicit")
    assert case.text == TEXT


def test_a_study_is_told_as_such():
    study = PAPER.parent / "study.toml"
    said = ["case.toml: is a study, not a case; ringwear sweep computes it"]
    assert faults(study.read_text(), "load.pressure=50") == said
    with pytest.raises(InputError, match="case: is a study, not a case"):
        read_case({"case": "paper.toml", "vary": {}})
    with pytest.raises(InputError, match="case: is a fit file, not a case"):
        read_case({"case": "paper.toml", "fit": {}, "experiment": []})


def test_overrides_enter_the_text_that_is_stored():
    case = read_case(PAPER, ["load.force=100", 'title=a "b" c', "output.fields=['pressure']"])
    assert case.load.force == 100
    again = parse_case(case.text, "stored")
    assert again == case
    assert again.title == 'a "b" c'
    assert again.output.fields == ("pressure",)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("lower.young=-1", ["lower.young = -1", "must be a finite number > 0", "MPa"]),
        ("upper.poisson=0.5", ["upper.poisson = 0.5", "> -1 and < 0.5"]),
        ("lower.r=[40, 20]", ["lower.r", "two increasing numbers"]),
        ('lower.young="stiff"', ['lower.young = "stiff"', "a finite number"]),
        ("wear.lower.k=nan", ["wear.lower.k = nan", "finite"]),
        ("time.scheme=magic", ['"magic"', '"implicit" or "explicit"']),
        ("mesh.contact_elements=2", ["mesh.contact_elements = 2", "whole number from 4"]),
        ("output.fields=['pressure', 'temperature']", ["output.fields", '"wear_upper"']),
        ("lower.yung=1", ["lower.yung: unknown key", "did you mean lower.young?"]),
        ("upper.r=[41, 45]", ["do not overlap", "if upper.r are diameters, write [20.5, 22.5]"]),
        ("load.control=displacement", ["load.displacement is missing", "load.pressure = 80"]),
        ("lower=3", ["lower = 3: must be a table"]),
        ("output.boundary=[300]", ["output.boundary: 300 is after the end", "<= 200 (s)"]),
        ("output.boundary=[10, 5]", ["output.boundary = [10, 5]", "a list of increasing times"]),
        ("output.times=[5, 5]", ["output.times = [5, 5]", "increasing numbers > 0"]),
        ("load.omega=[[0, 1], [0, 2]]", ["load.omega", "0 after 0", "must increase"]),
        ("load.pressure=[[0, 80], [5, -1]]", ["load.pressure", "[[t, value >= 0], ...]"]),
        ("wear.lower.k={r=[[31, 1], [30, 1]]}", ["wear.lower.k", "30 after 31"]),
        ("wear.lower.m=2", ["wear.lower.m: has no meaning", "must be among k, p0"]),
        ("wear.lower.law=power", ["wear.lower.m is missing", 'wear.lower.law = "power"']),
        ("lower.young=1e308", ["lower.young = 1e+308", "from 1e-60 to 1e+30 in magnitude"]),
        ("nonsense", ["--set nonsense", "KEY=VALUE"]),
    ],
)
def test_each_fault_has_its_sentence(override, words):
    told = faults(TEXT, override)
    text = "\n".join(told)
    for word in words:
        assert word in text
    assert all("Traceback" not in line for line in told)


DISC = ["upper.r=[0, 31.5]"]
PUSHED = ["load.control=displacement", "load.displacement=0.5"]


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["upper.chamfer=-0.1"], ["upper.chamfer = -0.1", "a number >= 0, or two", "mm"]),
        (["upper.chamfer=[0.1]"], ["upper.chamfer = [0.1]", "two of them: [inner, outer]"]),
        (["upper.chamfer=1.5"], ["upper.chamfer = [1.5, 1.5]", "smaller than the width", "3 (mm)"]),
        (["upper.chamfer=[0, 25]", "upper.r=[1, 40]"], ["smaller than the height, 20 (mm)"]),
        ([*DISC, "upper.chamfer=[0.1, 0.1]"], ["no inner corner", "must be 0"]),
        (["upper.chamfer=0.1", "upper.profile=[[28.5, 20], [31.5, 21]]"],
         ["upper.chamfer, upper.profile: both are given"]),
        (["lower.profile=[[20, 20]]"], ["lower.profile", "at least 2 points [r, z]"]),
        (["lower.profile=[[20, 20], [40, nan]]"], ["lower.profile", "finite numbers or"]),
        (["lower.profile=[[20, 20], [39, 20]]"],
         ["lower.profile[1] = [39, 20]", "outer end must have r = 40 (mm)"]),
        (["lower.profile=[[21, 20], [40, 20]]"], ["lower.profile[0]", "inner end", "r = 20"]),
        (["lower.profile=[[20, 20], [30, 20.5], [40, 20]]"],
         ["lower.profile[1] = [30, 20.5]: leaves the body", "> 0 and <= 20 (mm)"]),
        (["upper.profile=[[28.5, 20], [30, 19.9], [31.5, 20]]"],
         ["upper.profile[1] = [30, 19.9]: leaves the body", ">= 20 and < 40"]),
        (["lower.profile=[[20, 20], [30, 19], [30, 18], [40, 20]]"],
         ["lower.profile[2] = [30, 18]", "does not face the other body", "> 30"]),
        (["lower.profile=[[20, 10], [35, 10], [35, 15], [25, 5], [40, 20]]"],
         ["lower.profile[2] = [35, 15]: the profile crosses itself"]),
        (["mesh.contact=[40, 50]"], ["mesh.contact = [40, 50]", "in common with [28.5, 31.5]"]),
        (["mesh.geometry_tolerance=0"], ["mesh.geometry_tolerance = 0", "> 0 (mm)"]),
        (["upper.chamfer=0.1", "mesh.contact_elements=11"],
         ["case.toml", "mesh.contact_elements = 11", "3 pieces", "at least 12"]),
        ([*PUSHED, "upper.z=[19, 40]"],
         ["load.displacement = 0.5", "interpenetrate by 1", "at least that (mm)"]),
    ],
)  # fmt: skip
def test_each_fault_of_a_shape_has_its_sentence(overrides, words):
    text = "\n".join(faults(TEXT, *overrides))
    for word in words:
        assert word in text


def test_rings_need_not_touch():
    apart = read_case(PAPER, ["upper.z=[21, 40]"])
    assert apart.initial_gap == pytest.approx(1.0)
    assert apart.interpenetration == 0.0
    deep = read_case(PAPER, ["upper.z=[19.75, 40]"])
    assert deep.interpenetration == pytest.approx(0.25)
    assert deep.initial_gap.max() == pytest.approx(-0.25)
    assert read_case(PAPER, [*PUSHED, "upper.z=[19.75, 40]"]).load.displacement == 0.5
    assert read_case(PAPER, ["upper.z=[19.9999999999, 40]"]).interpenetration == 0.0


def test_shapes_give_the_initial_gap():
    case = read_case(PAPER, ["upper.chamfer=[0.2, 0.1]"])
    r = case.line.gap_point
    exact = np.maximum(0, np.maximum(28.7 - r, r - 31.4))
    assert case.initial_gap == pytest.approx(exact, abs=1e-13)
    assert case.area == pytest.approx(math.pi * (31.5**2 - 28.5**2))
    case = read_case(PAPER, [
        "lower.profile=[[20.0000000001, 19], [30, 20], [40, 18]]",
        "upper.profile=[[28.5, 21], [31.5, 20.5]]", "mesh.contact=[29, 31.5000000001]",
    ])  # fmt: skip
    r = case.line.gap_point
    lower = np.where(r < 30, 19 + (r - 20) / 10, 20 - 0.2 * (r - 30))
    assert case.initial_gap == pytest.approx(21 - (r - 28.5) / 6 - lower, abs=1e-9)
    assert case.contact == (29, 31.5)
    assert case.open_ends == (True, False)
    assert 30.0 in case.line.edges
    assert case.area == pytest.approx(math.pi * (31.5**2 - 28.5**2))


def test_a_chamfer_of_a_disc_is_its_outer_corner():
    case = read_case(PAPER, [*DISC, "upper.chamfer=0.1", "lower.r=[0, 40]"])
    assert case.upper.face == ((0.0, 0.0), (31.4, 0.0), (31.5, -0.1))


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


def test_all_faults_together_and_by_origin():
    told = faults(
        TEXT.replace("young = 10e3", "young = -10e3").replace("friction = 0.1", ""),
        "upper.poisson=2", "time.steps=0", "oops.x=1",
    )  # fmt: skip
    assert len(told) == 5
    assert sum(line.startswith("case.toml: ") for line in told) == 2
    assert sum(line.startswith("--set ") for line in told) == 3
    assert any("contact.friction is missing" in line for line in told)


def test_both_or_neither_load():
    assert "both are given" in faults(TEXT.replace("omega", "force = 5.0\nomega"))[0]
    without = "\n".join(line for line in TEXT.splitlines() if not line.startswith("pressure"))
    assert "neither" in faults(without)[0]


def test_broken_toml_names_the_line():
    told = faults(TEXT.replace("friction = 0.1", "friction = = 0.1"))
    line = TEXT.splitlines().index(next(x for x in TEXT.splitlines() if "friction" in x)) + 1
    assert len(told) == 1
    assert f"line {line}" in told[0]


def test_any_title_is_stored_as_it_is():
    title = 'a "quoted"\\ \t\r\n \u00b5m'
    case = parse_case(TEXT, "case.toml", {"title": title})
    assert parse_case(case.text, "stored").title == title


def test_elements_that_drown_in_round_off_are_refused():
    case = read_case(PAPER, ["lower.r=[20, 28.5000001]", "mesh.grading=6"])
    with pytest.raises(InputError, match=r"mesh\.grading = 6"):
        check_mesh(case, "case.toml")


@pytest.mark.parametrize("keys", [KEYS, studies.KEYS, fits.KEYS])
def test_schema_lists_every_key(keys):
    text = " ".join(key_table(keys).split())
    for key in keys:
        assert f"{key.path} {key.unit} " in text
        assert key.meaning in text
        assert key.allowed in text


def test_schema_lists_the_rows_that_contain_a_word():
    rows = re.findall(r"^[a-z]\S+", key_table(KEYS, "Wear.Lower"), re.MULTILINE)[1:]
    assert rows == [k.path for k in KEYS if "wear.lower" in f"{k.path} {k.meaning} {k.allowed}"]
    assert "wear.lower.k" in rows
    assert key_table(KEYS, "unheard of") == ""
