"""Numbers that are likely in another unit than meant are doubted, those of our cases are not."""

import pytest
from mpi4py import MPI
from paths import CASES, PAPER

import ringwear_par as rw
from ringwear_par.cases.unit_suspicions import deep_forecasts, unit_suspicions
from ringwear_par.history.loop import simulate_one
from ringwear_par.wear.laws.archard import ArchardLaw

pytestmark = pytest.mark.serial

LAYERED = CASES / "wear_through.toml"


def told(path, **changes):
    """Return what is doubted of a case with some of its keys changed, by key."""
    doubts = unit_suspicions(rw.read_case(path, changes))
    assert {doubt.code for doubt in doubts} <= {"implausible_numbers"}
    return {"".join(doubt.keys): doubt.text for doubt in doubts}


@pytest.mark.parametrize("path", sorted(CASES.glob("*.toml")), ids=lambda path: path.stem)
def test_numbers_of_our_cases_are_not_doubted(path):
    if "[vary]" not in path.read_text():
        assert told(path) == {}


@pytest.mark.parametrize(("factor", "unit"), [(1e-3, "m"), (1e3, "um")])
def test_rings_in_other_lengths_are_doubted(factor, unit):
    case = rw.read_case(PAPER)
    keys = {f"{body}.{axis}": [factor * end for end in getattr(getattr(case, body), axis)]
            for body in ("lower", "upper") for axis in "rz"}  # fmt: skip
    assert told(PAPER, **keys)[""].endswith(f" mm; plain lengths are in mm: is it in {unit}?")


def test_a_thickness_in_metres_is_doubted():
    key = "lower.layers[0].thickness"
    (text,) = told(LAYERED, **{key: 4e-6}).values()
    assert text.startswith(f"{key} = 4e-06 mm is 4 nm, thinner than")
    assert text.endswith('if it is in m, write "4e-06 m", which is 4 um')
    assert rw.read_case(LAYERED, {key: "4e-06 m"}).lower.layers[0].thickness == 4e-3
    assert told(LAYERED, **{key: "0.1 um"}) == {}


@pytest.mark.parametrize(
    ("law", "k", "most"),
    [
        ("archard", 0.1, "0.1 mm3/(N m)"),
        ("threshold", 10.0, "1 mm3/(N m)"),  # over friction, 0.1
    ],
)
def test_a_k_in_another_unit_is_doubted(law, k, most):
    key, keys = "wear.lower.k", {"wear.lower.law": law, "time.end": 1e-3}  # s, worn little
    assert told(LAYERED, **keys, **{key: most}) == {}
    text = told(LAYERED, **keys, **{key: k})[key]
    assert "1/MPa is a specific wear rate of " in text
    assert "more than that of any material in dry sliding, 0.1; if it is in mm3/(N m), " in text
    assert text.endswith(' mm3/(N m)"')


PAPER = PAPER
#: a washer 5 mm high that loses 10 um as meant
WASHER = {"lower.z": [-5.0, 0.0], "wear.lower.law": "archard", "time.scheme": "adaptive",
          "time.step": None, "time.steps": None}  # fmt: skip


def washer(k, depth):
    """Return keys of a washer worn to a depth (mm) at the mean pressure."""
    case = rw.read_case(PAPER, WASHER | {"wear.lower.k": k, "time.end": 1.0})
    rate = case.wear_lower.k * case.load.force / case.area * case.load.omega * sum(case.overlap) / 2
    return WASHER | {"wear.lower.k": k, "time.end": depth / rate}


@pytest.mark.parametrize(
    ("law", "key"),
    [
        ({"law": "archard", "k": 1.2e-6}, "wear.lower.k"),
        ({"law": "power", "k": 1.2e-6, "m": 1.0}, "wear.lower"),
        ({"law": "power", "k": [[0.0, 0.6e-6], [8.0, 1.8e-6]], "m": 1.0}, "wear.lower"),
        ({"law": "threshold", "k": 1.2e-5}, "wear.lower.k"),
        ({"law": "running-in", "k": 1.2e-5, "k_start": 2e-5, "depth": 0.01}, "wear.lower.k"),
        ({"law": "non-local", "k": 1.2e-5, "length": 0.1}, "wear.lower.k"),
    ],
)
def test_each_law_forecasts_the_wear_at_the_mean_pressure(law, key):
    """Archard's 1.2e-6, the others' at friction 0.1: 10 mm. With the unit that was meant, none."""
    keys = washer(1.2e-6, 10.0) | {"wear.lower": None, "contact.friction": 0.1}
    keys = {k: v for k, v in keys.items() if not k.startswith("wear.lower.")}
    end = keys["time.end"]
    law = {k: [[t * end / 8.0, x] for t, x in v] if isinstance(v, list) else v
           for k, v in law.items()}  # fmt: skip
    (text,) = [told(PAPER, **keys, **{f"wear.lower.{k}": v for k, v in law.items()})[key]]
    assert " would wear 10 mm off lower by t = " in text
    assert text.endswith(' mm3/(N m)"') == (key == "wear.lower.k")
    assert told(PAPER, **keys | {"time.end": end / 100.0},
                **{f"wear.lower.{k}": v for k, v in law.items()}) == {}  # fmt: skip


@pytest.mark.parametrize("scheme", ["adaptive", "implicit"])
def test_a_run_that_fails_by_deep_wear_asks_for_the_unit(scheme):
    """Whatever the step: fixed ones fail at once, with nothing worn before."""
    keys = washer(1.2e-6, 10.0) | {"mesh.contact_elements": 12, "time.scheme": scheme}
    if scheme == "implicit":
        keys |= {"time.step": keys["time.end"] / 2, "time.steps": 2, "time.end": None}
    with pytest.raises(rw.ComputationError) as failure:
        simulate_one(rw.read_case(PAPER, keys), MPI.COMM_SELF)
    question = (
        '. wear.lower.k = 1.2e-06 is in 1/MPa: if it is in mm3/(N m), write "1.2e-06 mm3/(N m)"'
    )
    assert str(failure.value).endswith(question)
    assert "more than half of its height" in str(failure.value)
    case = rw.read_case(PAPER, keys | {"wear.lower.k": "1.2e-3 mm3/(N m)"})
    with pytest.raises(rw.ComputationError) as failure:
        simulate_one(case, MPI.COMM_SELF)
    assert "more than half of its height" in str(failure.value)
    assert "mm3/(N m)" not in str(failure.value) + str(unit_suspicions(case))


def test_much_wear_is_one_warning_that_asks_for_the_unit():
    keys = washer(1.2e-6, 0.6) | {"mesh.contact_elements": 12}
    result = rw.simulate(rw.read_case(PAPER, keys), MPI.COMM_SELF)
    (text,) = [one.text for one in result.doubts if "wear.lower.k" in one.text]
    assert "more than 5 % of a body's height" in text
    assert text.endswith('if it is in mm3/(N m), write "1.2e-06 mm3/(N m)"')
    assert [doubt["text"] for doubt in result.to_dict()["doubts"]].count(text) == 1


@pytest.mark.parametrize(
    ("young", "poisson", "pressure", "doubted"),
    [
        (4, 0.38, 50.0, True),
        (0.5, 0.3, 0.01, True),
        (210, 0.3, 0.1, True),
        (70, 0.33, 5.0, True),
        (4.0, 0.49, 0.3, False),  # rubber
        (10.0, 0.499, 0.5, False),
        (500.0, 0.46, 10.0, False),  # PTFE
        (700.0, 0.4, 15.0, False),  # UHMWPE
        (60.0, 0.25, 1.5, False),  # friction paper
        (4000.0, 0.38, 50.0, False),  # PEEK
    ],
)
def test_a_modulus_in_gigapascals_is_doubted_and_that_of_soft_materials_is_not(
    young, poisson, pressure, doubted
):
    load = {"load.force": None, "load.pressure": pressure, "wear.lower.k": 1e-12}
    texts = told(PAPER, **load, **{"lower.young": young, "lower.poisson": poisson}).values()
    assert len(texts) == doubted
    assert all(text.endswith(f'if it is in GPa, write "{young:g} GPa"') for text in texts)


@pytest.mark.parametrize(
    ("load", "said"),
    [
        ({}, "the approach begins with that way"),
        ({"load.control": "displacement", "load.pressure": None, "load.displacement": 0.5},
         "load.displacement is 0.5 mm at most, so the bodies never touch and nothing wears"),
    ],
)  # fmt: skip
def test_bodies_that_are_apart(load, said):
    keys = {"upper.z": [21, 41], "time.steps": 1, "mesh.contact_elements": 12, **load}
    (doubt,) = rw.simulate(rw.read_case(PAPER, keys), MPI.COMM_SELF).doubts
    text = doubt.text
    assert text.startswith("the unloaded faces are 1 mm apart (lower.z ends at 20 mm, upper.z beg")
    assert said in text


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


def test_laws_that_take_one_history_only_are_forecast_one_by_one(monkeypatch):
    cases = [rw.read_case(PAPER, washer(k, 1.0)) for k in (1e-6, 2e-6)]
    expected, rate = deep_forecasts(cases), ArchardLaw.rate
    assert all(expected)
    monkeypatch.setattr(ArchardLaw, "rate", lambda law, p, local: rate(law, p.item(), local))
    assert deep_forecasts(cases) == expected
    monkeypatch.setattr(ArchardLaw, "rate", lambda law, p, local: p / local.missing)
    with pytest.raises(AttributeError, match="missing"):  # a fault of ours is not hidden
        deep_forecasts(cases)
