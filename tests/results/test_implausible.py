"""Numbers that are likely in another unit than meant are doubted, those of our cases are not."""

from pathlib import Path

import pytest
from mpi4py import MPI

import ringwear_par as rw
from ringwear_par.results.implausible import implausible

CASES = Path(__file__).parents[2] / "scripts" / "cases"
LAYERED = CASES / "wear_through.toml"


def told(path, **changes):
    """Return what is doubted of a case with some of its keys changed, by key."""
    doubts = implausible(rw.read_case(path, changes))
    assert {doubt.flag for doubt in doubts} <= {"implausible_numbers"}
    return {doubt.key: doubt.text for doubt in doubts}


@pytest.mark.parametrize("path", sorted(CASES.glob("*.toml")), ids=lambda path: path.stem)
def test_numbers_of_our_cases_are_not_doubted(path):
    if "[vary]" not in path.read_text():
        assert told(path) == {}


def test_a_thickness_in_metres_is_doubted():
    key = "lower.layers[0].thickness"
    (text,) = told(LAYERED, **{key: 4e-6}).values()
    assert text.startswith(f"{key} = 4e-06 mm is 4 nm, thinner than")
    assert text.endswith('were it in m, "4e-06 m" would be read too, as 4 um')
    assert rw.read_case(LAYERED, {key: "4e-06 m"}).lower.layers[0].thickness == 4e-3
    assert told(LAYERED, **{key: "0.1 um"}) == {}


@pytest.mark.parametrize(
    ("law", "k", "most"),
    [
        ("archard", "1e-7 m3/(N m)", "0.1 mm3/(N m)"),
        ("threshold", "1e-5 m3/(N m)", "1 mm3/(N m)"),  # over friction, 0.1
    ],
)
def test_a_k_in_another_unit_is_doubted(law, k, most):
    key = "wear.lower.k"
    assert told(LAYERED, **{"wear.lower.law": law, key: most}) == {}
    text = told(LAYERED, **{"wear.lower.law": law, key: k})[key]
    assert "1/MPa is a specific wear rate of " in text
    assert "more than that of any material in dry sliding, 0.1; were it in mm3/(N m), " in text
    assert text.endswith("would be read too")


def test_a_k_at_the_start_is_doubted_by_itself():
    wear = {"law": "running-in", "k": 1e-7, "k_start": 0.1, "depth": 1.0}
    found = told(LAYERED, **{f"wear.lower.{name}": value for name, value in wear.items()})
    assert found.keys() == {"wear.lower.k_start"}


def test_a_k_of_a_layer_is_doubted_by_its_own_name():
    (text,) = told(LAYERED, **{"lower.layers[0].wear.k": 0.1}).values()
    assert text.startswith("lower.layers[0].wear.k = 0.1 1/MPa is a specific wear rate of 10 mm3")


@pytest.mark.serial
def test_what_a_study_varies_is_not_doubted(tmp_path):
    """The same numbers are where they are set once for all cases."""
    small = {"mesh.contact_elements": 12, "time.scheme": "implicit", "time.step": 1e-9,
             "time.steps": 1, "time.end": None}  # fmt: skip
    key = "lower.layers[0].thickness"

    def flags(name, vary, **changes):
        case = rw.read_case(LAYERED, {**small, **changes})
        study = {"case": str(tmp_path / "case.toml"), "vary": vary, "design": {"method": "grid"}}
        (tmp_path / "case.toml").write_text(case.text)
        rw.sweep(rw.read_study(study), tmp_path / name, MPI.COMM_SELF)
        return [
            "implausible_numbers" in str(row)
            for row in rw.open_ensemble(tmp_path / name)["flags"].values
        ]

    thin = {key: {"values": [5e-5, 3e-3]}}
    assert flags("varied", thin) == [False, False]
    assert flags("beside", thin, **{"wear.lower.k": 0.1}) == [True, True]
    load = {"load.pressure": {"values": [10.0, 20.0]}}
    assert flags("set", load, **{key: 5e-5}) == [True, True]
    updated = {"mesh.geometry": "updated"}  # one by one
    assert flags("alone", thin, **updated) == [False, False]
    assert flags("alone_set", load, **{key: 5e-5}, **updated) == [True, True]
