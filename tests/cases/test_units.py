"""Numbers with units in cases, overrides and studies, and faces by name."""

import re

import numpy as np
import pytest
from paths import CASES, PAPER

import ringwear_par as rw
from ringwear_par.cases.units import number_in, with_signs

CROWN = CASES / "crown.toml"
RADII = np.linspace(10.0, 15.0, 301)


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("60 rpm", "rad/s", 2.0 * np.pi),
        ("2 turn/s", "rad/s", 4.0 * np.pi),
        ("90 deg/s", "rad/s", 0.5 * np.pi),
        ("10 h", "s", 36000.0),
        ("28.5mm", "mm", 28.5),
        ("0.1 um", "mm", 1e-4),
        ("-25 \u00b5m", "mm", -0.025),
        ("1.2e-2 m", "mm", 12.0),
        ("210 GPa", "MPa", 210e3),
        ("5 kN", "N", 5000.0),
        ("1e-5 mm3/(N m)", "1/MPa", 1e-8),
        ("1e-5 mm^3/Nm", "1/MPa", 1e-8),
        ("1e-13 m2/N", "1/MPa", 1e-7),
        ("1e-7/MPa", "1/MPa", 1e-7),
        ("80 N m^-2", "MPa", 8e-5),
        ("5 N m", "N mm", 5000.0),
        ("7850 kg/m3", "g/mm^3", 0.00785),
    ],
)
def test_a_number_with_its_unit_is_one_in_the_unit_of_its_key(text, unit, value):
    assert number_in(text, unit) == pytest.approx(value, rel=1e-14)


def test_figures_and_pages_write_units_in_signs():
    text = "12 um: 3 um/h, 1e-05 mm3/(N m); z_um of 3 umbrellas in vacuum, um.csv, 4 mm3.csv"
    exact = "12 µm: 3 µm/h, 1e-05 mm³/(N m); z_um of 3 umbrellas in vacuum, um.csv, 4 mm3.csv"
    assert with_signs(text) == exact
    assert number_in(with_signs("5 mm3"), "um^3") == pytest.approx(5e9)


def test_parameters_of_a_users_law_are_in_the_units_of_a_case():
    keys = {"k": "2e-4 mm3/(N m)", "p1": [["0 min", "60 N/mm2"], ["1 h", 70]], "speed": "60 rpm",
            "energy": "3 J", "density": "1.9 g/cm3", "plain": 5}  # fmt: skip
    changes = {f"wear.lower.parameters.{name}": value for name, value in keys.items()}
    law = rw.read_case(CASES / "user_law.toml", changes).wear_lower
    values = {name: law.quantities[f"parameters.{name}"] for name in keys}
    assert values.pop("p1").x == (0.0, 3600.0)
    assert values == pytest.approx({
        "k": 2e-7, "speed": 2.0 * np.pi, "energy": 3000.0, "density": 1.9e-3, "plain": 5.0,
    })  # fmt: skip


def test_units_serve_wherever_a_case_has_numbers():
    changes = {
        "lower.r": ["2 cm", "40 mm"],
        "upper.chamfer": "100 um",
        "wear.lower.p0": [["0 min", "20 MPa"], ["1 min", "300 bar"]],
        "wear.lower.k": {"r": [["2.85 cm", "1e-4 mm3/(N m)"], ["31.5 mm", 2e-7]]},
        "load.pressure": [[0, "50 MPa"], ["1 min", 80]],
        "output.times": ["0.5 min", 60],
    }
    plain = {
        "lower.r": [20.0, 40.0],
        "upper.chamfer": 0.1,
        "wear.lower.p0": [[0.0, 20.0], [60.0, 30.0]],
        "wear.lower.k": {"r": [[28.5, 1e-7], [31.5, 2e-7]]},
        "load.pressure": [[0.0, 50.0], [60.0, 80.0]],
        "output.times": [30.0, 60.0],
    }
    case = rw.read_case(PAPER, changes)
    assert case == rw.read_case(PAPER, plain)
    assert case == case.replace({}) == rw.read_case(PAPER, changes).replace({})  # by its text
    assert case.replace({"load.omega": "60 rpm"}).load.omega == pytest.approx(2.0 * np.pi)
    assert rw.read_case(PAPER, ["load.omega=60 rpm"]).load.omega == pytest.approx(2.0 * np.pi)


def test_named_faces_are_what_they_are_called():
    def face(**shape):
        return rw.read_case(CROWN, {"upper.profile": shape}).sections[1].depth(r)

    r, cone = RADII, np.tan(np.radians(2.0))
    crown = np.sqrt(500.0**2 - (r - 12.5) ** 2) - 500.0
    assert face(crown="0.5 m") == pytest.approx(crown, abs=1e-9)
    sphere = np.sqrt(40.0**2 - r**2) - np.sqrt(40.0**2 - 100.0)
    assert face(sphere=40.0) == pytest.approx(sphere, abs=1e-6)
    assert face(cone=2.0) == pytest.approx(-cone * (r - 10.0), abs=1e-12)
    assert face(cone=-2.0) == pytest.approx(-cone * (15.0 - r), abs=1e-12)
    fillet, into = face(fillet=[0.0, 0.5]), np.maximum(r - 14.5, 0.0)
    circle = np.sqrt(0.25 - into**2) - 0.5
    steep = into > 0.5 * np.sin(np.radians(60.0))  # where no contact is
    assert fillet[~steep] == pytest.approx(circle[~steep], abs=2e-4)
    assert face(fillet=0.5)[[0, -1]] == pytest.approx([-0.5, -0.5])


def test_a_trace_of_a_profilometer_is_a_face(tmp_path):
    r = np.linspace(9.9, 15.1, 105)
    rows = [f"{x:.3f};{1e3 * (0.2 - (x - 12.5) ** 2 / 1000.0):.4f}".replace(".", ",") for x in r]
    (tmp_path / "trace.csv").write_text("# heights\nr [mm];height_um\n" + "\n".join(rows) + "\n")
    text = CROWN.read_text().replace("{ crown = 500.0 }", '{ file = "trace.csv" }')
    (tmp_path / "case.toml").write_text(text)
    case = rw.read_case(tmp_path / "case.toml")
    parabola = -((RADII - 12.5) ** 2) / 1000.0
    assert case.sections[1].depth(RADII) == pytest.approx(parabola, abs=1e-6)
    assert rw.read_case(CROWN, [f"upper.profile.file={tmp_path / 'trace.csv'}"]).upper == case.upper
    (tmp_path / "trace.csv").unlink()
    assert case.replace({}) == case  # the text has the points


@pytest.mark.parametrize(
    ("heights", "word"), [("z_MPa", "MPa"), ("z_um [tip]", "[tip]"), ("z_mm", "rough")]
)
def test_traces_that_cannot_be_a_face(heights, word, tmp_path):
    depths = np.random.default_rng(1).random(500)
    rows = [f"{r:.3f},{z:.5f}" for r, z in zip(np.linspace(10, 15, 500), depths, strict=True)]
    (tmp_path / "trace.csv").write_text("\n".join([f"r_mm,{heights}", *rows]))
    with pytest.raises(rw.InputError, match=re.escape(word)):
        rw.read_case(CROWN, {"upper.profile": {"file": str(tmp_path / "trace.csv")}})
