"""Cases from files, dicts and overrides: the same checks, and nothing that is given in vain."""

import tomllib

import numpy as np
import pytest
from paths import CASES, PAPER
from wearing import ThresholdLaw

import ringwear_par as rw
from ringwear_par.cases.files.keys import read_keys
from ringwear_par.cases.files.reading import parse_case, read_case

TEXT = PAPER.read_text()
FILES = sorted(p for p in CASES.glob("*.toml") if "lower" in tomllib.loads(p.read_text()))
ADAPTIVE = TEXT.replace('"implicit"', '"adaptive"')
BOTH = ADAPTIVE + "end = 20.0\n"


@pytest.mark.parametrize("path", FILES, ids=[path.stem for path in FILES])
def test_a_dict_is_as_good_as_a_file(path, monkeypatch):
    monkeypatch.chdir(CASES)  # files that a dict names are relative to the current folder
    text = path.read_text()
    from_file = read_case(path)
    assert read_case(str(path)) == from_file
    for source in (tomllib.loads(text), read_keys(text)):
        case = read_case(source)
        assert case == from_file
        monkeypatch.chdir("/")
        assert parse_case(case.text, "again") == from_file
        assert case.replace({}) == from_file
        monkeypatch.chdir(CASES)


def test_values_of_numpy_are_numbers():
    changes = {
        "load.pressure": np.float32(50),
        "lower.r": np.array([20, 41]),
        "lower.z": (0, 20),
        "mesh.contact_elements": np.int64(32),
        "upper.profile": np.array([[28.5, 20.0], [30.0, 20.1], [31.5, 20.0]]),
        "load.omega": [(0, 1), (np.float64(5), 2)],
    }
    case = read_case(PAPER, changes)
    assert case.load.force == pytest.approx(50 * case.area, rel=1e-15)
    assert case.lower.r == (20.0, 41.0)
    assert case.mesh.contact_elements == 32
    assert case.upper.face == pytest.approx(np.array([[28.5, 0], [30, -0.1], [31.5, 0]]), abs=1e-14)
    assert parse_case(case.text, "again") == case
    texts = ["load.pressure=50", "lower.r=[20, 41]", "mesh.contact_elements=32",
             "upper.profile=[[28.5, 20], [30, 20.1], [31.5, 20]]",
             "load.omega=[[0, 1], [5, 2]]"]  # fmt: skip
    assert read_case(PAPER, texts) == case


def test_replace_is_a_changed_and_checked_copy():
    case = read_case(PAPER)
    changed = case.replace({"load.pressure": 50, "wear.lower.k": 2e-7})
    assert case == read_case(PAPER)
    assert changed == read_case(PAPER, ["load.pressure=50", "wear.lower.k=2e-7"])
    assert changed == case.replace(["load.pressure=50", "wear.lower.k=2e-7"])
    assert changed.replace({"load.pressure": 80.0, "wear.lower.k": 1e-7}) == case
    pushed = case.replace({"load.control": "displacement", "load.displacement": 0.05})
    assert (pushed.load.force, pushed.load.displacement) == (None, 0.05)
    with pytest.raises(rw.InputError, match=r"load.omega"):
        case.replace({"load.omega": -1})
    both = case.replace({"wear.upper": {"law": "archard", "k": 1e-9}})
    changed = both.replace({"wear.lower": None})  # a table that is taken away
    assert (changed.wear_lower, changed.wear_upper) == (None, both.wear_upper)
    with pytest.raises(rw.InputError, match=r"upper.r"):
        both.replace({"upper": None})


def test_a_table_takes_the_place_of_the_one_before():
    case = read_case(PAPER)
    assert case.wear_lower.values["p0"] > 0.0
    table = {"law": "threshold", "k": 2e-7}
    for changes in ({"wear.lower": table}, ["wear.lower={law='threshold', k=2e-7}"]):
        assert read_case(PAPER, changes).wear_lower == ThresholdLaw(2e-7)
    grid = ["stress.grid={r=[28, 32], z=[19, 21], n=[5, 4]}"]
    with pytest.raises(rw.InputError, match=r"stress\.grid\.n is missing"):
        read_case(PAPER, grid).replace({"stress.grid": {"r": [28.0, 30.0], "z": [19.0, 20.0]}})


def test_a_byte_order_mark_is_no_part_of_a_text(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(TEXT, encoding="utf-8-sig")
    assert path.read_bytes()[:3] == b"\xef\xbb\xbf"
    case = read_case(path)
    assert case == read_case(PAPER)
    assert case.text == TEXT
    law = (CASES / "user_law.py").read_text()
    (tmp_path / "user_law.py").write_text(law, encoding="utf-8-sig")
    path.write_text((CASES / "user_law.toml").read_text(), encoding="utf-8-sig")
    assert read_case(path).wear_lower.code.source == law


@pytest.mark.parametrize(
    ("text", "overrides", "same"),
    [
        # README: the end of an adaptive history is that of the fixed steps, or its own
        (TEXT, ["time.scheme=adaptive"], None),
        (TEXT, ["time.scheme=adaptive", "time.end=20"], BOTH.replace("step", "# step")),
        (ADAPTIVE, ["time.end=20"], BOTH.replace("step", "# step")),
        (BOTH.replace("step", "# step"), ["time.step=1.0", "time.steps=200"], ADAPTIVE),
        (TEXT, ["upper.r[1]=3.2 cm"], TEXT.replace("31.5", "32")),
        # what the file says for the other scheme, geometry or output goes
        (BOTH + "tolerance = 1e-5\n", ["time.scheme=implicit"], TEXT),
        (TEXT + '[mesh]\ngeometry = "updated"\ngeometry_tolerance = 0.01\n',
         ["mesh.geometry=fixed"], TEXT),
        (TEXT + "[output]\ntimes = [5]\n", ["output.every=3"], TEXT + "[output]\nevery = 3\n"),
        (TEXT + "[output]\nevery = 3\n", ["output.times=[5]"], TEXT + "[output]\ntimes = [5]\n"),
        (TEXT + '[output]\nprofiles = "last"\n', ["output.fields=[]"],
         TEXT + "[output]\nfields = []\n"),
        (TEXT.replace("[contact]", "chamfer = 0.1\n[contact]"),
         ["upper.profile=[[28.5, 20], [31.5, 21]]"],
         TEXT.replace("[contact]", "profile = [[28.5, 20], [31.5, 21]]\n[contact]")),
    ],
)  # fmt: skip
def test_an_override_takes_with_it_what_has_no_meaning_then(text, overrides, same):
    case = parse_case(text, "case.toml", overrides)
    if same is None:
        assert case.time.adaptive
        assert case.time.end == 200.0
    else:
        assert case == parse_case(same, "same")
    assert parse_case(case.text, "stored") == case
