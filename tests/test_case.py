"""Case files: what is read, and a sentence for everything that is wrong."""

import math
from pathlib import Path

import pytest

from ringwear_par.case import parse_case, parse_overrides, read_case, toml_text
from ringwear_par.errors import InputError
from ringwear_par.pair import check_memory, check_mesh
from ringwear_par.schema import KEYS, schema
from ringwear_par.wear import ThresholdLaw

PAPER = Path(__file__).parents[1] / "scripts" / "cases" / "paper.toml"
TEXT = PAPER.read_text()


def faults(text=TEXT, *overrides):
    with pytest.raises(InputError) as caught:
        parse_case(text, "case.toml", parse_overrides(overrides))
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


def test_overrides_enter_the_text_that_is_stored():
    case = read_case(PAPER, ["load.force=100", 'title=a "b" c', "output.fields=['pressure']"])
    assert case.load.force == 100
    again = parse_case(case.text, "stored")
    assert again == case
    assert again.title == 'a "b" c'
    assert again.output.fields == ("pressure",)


def test_an_overriding_load_replaces_the_files():
    case = read_case(PAPER, ["load.control=displacement", "load.displacement=0.05"])
    assert case.load.displacement == 0.05
    assert case.load.force is None


def test_toml_text_reads_back():
    import tomllib

    flat = {"a": 1, "b.c": [1.5, 2.0], "b.d.e": 'x\\y"z', "b.f": True, "g.h": 1e-7}
    tables = tomllib.loads(toml_text(flat))
    assert tables == {"a": 1, "b": {"c": [1.5, 2.0], "d": {"e": 'x\\y"z'}, "f": True},
                      "g": {"h": 1e-7}}  # fmt: skip


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("lower.young=-1", ["lower.young = -1", "must be a finite number > 0", "MPa"]),
        ("lower.young=0", ["lower.young = 0", "> 0"]),
        ("upper.poisson=0.5", ["upper.poisson = 0.5", "> -1 and < 0.5"]),
        ("upper.poisson=-1", ["upper.poisson = -1", "> -1 and < 0.5"]),
        ("lower.r=[40, 20]", ["lower.r", "two increasing numbers"]),
        ("lower.r=[20, 20]", ["lower.r", "two increasing numbers"]),
        ("lower.r=[-1, 40]", ["lower.r", ">= 0"]),
        ("lower.z=[20, 20]", ["lower.z", "two increasing numbers"]),
        ("lower.r=3", ["lower.r = 3", "two increasing numbers"]),
        ('lower.young="stiff"', ['lower.young = "stiff"', "a finite number"]),
        ("lower.young=true", ["lower.young = true"]),
        ("wear.lower.k=nan", ["wear.lower.k = nan", "finite"]),
        ("load.omega=inf", ["load.omega = inf", "finite"]),
        ("load.pressure=0", ["load.pressure = 0", "> 0"]),
        ("load.force=-5", ["load.force = -5", "> 0"]),
        ("time.step=0", ["time.step = 0", "> 0"]),
        ("time.steps=0", ["time.steps = 0", "whole number from 1"]),
        ("time.steps=1.5", ["time.steps = 1.5", "whole number"]),
        ("time.scheme=magic", ['"magic"', '"implicit" or "explicit"']),
        ("mesh.contact_elements=1e200", ["mesh.contact_elements = 1e+200", "to 1e+12"]),
        ("mesh.contact_elements=2", ["mesh.contact_elements = 2", "whole number from 4"]),
        ("output.fields=['pressure', 'temperature']", ["output.fields", '"wear_upper"']),
        ("upper.grip=glued", ['"clamped" or "platen"']),
        ("lower.yung=1", ["lower.yung: unknown key", "did you mean lower.young?"]),
        ("wear.lower.q0=1", ["unknown key", "did you mean wear.lower.p0?"]),
        ("upper.z=[21, 40]", ["upper.z[0] = 21", "lower.z[1] = 20", "do not touch"]),
        ("upper.z=[19, 40]", ["interpenetrate"]),
        ("upper.r=[41, 45]", ["do not overlap"]),
        ("lower.young=1" + 400 * "0", ["must be a finite number > 0"]),
        ("load.displacement=1", ["load.displacement = 1", 'needs load.control = "displacement"']),
        ("load.control=displacement", ["load.displacement is missing", "load.pressure = 80"]),
        ("lower=3", ["lower = 3: must be a table"]),
        ("nonsense", ["--set nonsense", "KEY=VALUE"]),
    ],
)
def test_each_fault_has_its_sentence(override, words):
    told = faults(TEXT, override)
    text = "\n".join(told)
    for word in words:
        assert word in text
    assert all("Traceback" not in line for line in told)


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


def test_missing_file():
    with pytest.raises(InputError, match=r"nowhere.toml: cannot be read"):
        read_case(Path("nowhere.toml"))


def test_a_wear_table_needs_its_coefficient():
    told = faults(TEXT + "\n[wear.upper]\np0 = 3.0\n")
    assert len(told) == 1
    assert told[0].startswith("case.toml: wear.upper.k is missing: must be a finite number >= 0")


def test_memory_is_stated_before_it_is_tried():
    case = read_case(PAPER, ["mesh.contact_elements=1000000000"])
    with pytest.raises(InputError, match=r"mesh.contact_elements = 1000000000.*needs .* GB"):
        check_memory(case, 1, "case.toml")
    check_memory(read_case(PAPER), 1, "case.toml")
    with pytest.raises(InputError, match=r"time.steps = 1000000000000.*needs .* GB"):
        check_memory(read_case(PAPER, ["time.steps=1e12"]), 1, "case.toml")


def test_an_empty_table_changes_nothing():
    case = read_case(PAPER, ["contact={}"])
    assert parse_case(case.text, "stored") == read_case(PAPER)


def test_any_title_is_stored_as_it_is():
    title = 'a "quoted"\\ \t\r\n \u00b5m'
    case = parse_case(TEXT, "case.toml", {"title": title})
    assert parse_case(case.text, "stored").title == title


def test_elements_that_drown_in_round_off_are_refused():
    case = read_case(PAPER, ["lower.r=[20, 28.5000001]", "mesh.grading=6"])
    with pytest.raises(InputError, match=r"mesh\.grading = 6"):
        check_mesh(case, "case.toml")


def test_schema_lists_every_key():
    text = schema()
    for key in KEYS:
        assert key.path in text
        assert key.meaning in text
