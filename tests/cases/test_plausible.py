"""Numbers that are likely in another unit than meant are doubted, those of our cases are not."""

import pytest
from mpi4py import MPI
from paths import CASES, PAPER

import ringwear_par as rw
from ringwear_par.cases.plausible import implausible_numbers

LAYERED = CASES / "wear_through.toml"


def doubted(path, **changes):
    """Return what is doubted of a case with some of its keys changed, by key."""
    return {d.keys[0]: d.text for d in implausible_numbers(rw.read_case(path, changes))}


@pytest.mark.parametrize("path", sorted(CASES.glob("*.toml")), ids=lambda path: path.stem)
def test_numbers_of_our_cases_are_plausible(path):
    if "[vary]" not in path.read_text():
        assert doubted(path) == {}


@pytest.mark.parametrize(
    ("key", "number", "meant"),
    [
        ("lower.young", 210.0, "210 GPa"),
        ("lower.young", 210e9, "2.1e+11 Pa"),
        ("lower.density", 7.85, "7.85 g/cm3"),
        ("lower.layers[0].thickness", 4e-6, "4e-06 m"),
        ("wear.lower.k", 0.02, "0.02 mm3/(N m)"),
    ],
)
def test_a_number_out_of_its_range_asks_for_the_unit_that_is_meant(key, number, meant):
    assert f'"{meant}"' in doubted(LAYERED, **{key: number})[key]
    assert doubted(LAYERED, **{key: meant}) == {}


@pytest.mark.parametrize(("factor", "unit"), [(1e-3, "m"), (1e3, "um")])
def test_rings_in_other_lengths_are_doubted(factor, unit):
    case = rw.read_case(PAPER)
    keys = {f"{body}.{axis}": [factor * end for end in getattr(getattr(case, body), axis)]
            for body in ("lower", "upper") for axis in "rz"}  # fmt: skip
    texts = doubted(PAPER, **keys)
    assert texts.keys() == {"lower.r[1]", "upper.r[1]"}
    assert all(text.endswith(f' {unit}"') for text in texts.values())


def test_rubbers_and_written_units_are_meant():
    rubber = {"lower.young": 4.0, "lower.poisson": 0.49}
    paper = {"lower.young": "60 MPa", "lower.poisson": 0.25}
    assert doubted(PAPER, **rubber) == doubted(PAPER, **paper) == {}


def washer(depth, k=1.2e-6, **more):
    """Return a case of a washer 5 mm high, worn to a depth (mm) if k is 1.2e-6 1/MPa."""
    keys = {"lower.z": [-5.0, 0.0], "wear.lower.law": "archard", "time.scheme": "adaptive",
            "mesh.contact_elements": 12, "time.step": None, "time.steps": None,
            "wear.lower.k": 1.0, "time.end": 1.0}  # fmt: skip
    case = rw.read_case(PAPER, keys)
    rate = 1.2e-6 * case.load.force / case.area * case.load.omega * sum(case.overlap) / 2
    return case.replace({"wear.lower.k": k, "time.end": depth / rate, **more})


def test_much_wear_is_one_warning_that_asks_for_the_unit():
    result = rw.simulate(washer(0.6), MPI.COMM_SELF)
    (text,) = [doubt.text for doubt in result.doubts if "wear.lower.k" in doubt.text]
    assert "5 % of a body's height" in text
    assert '"1.2e-06 mm3/(N m)"' in text


@pytest.mark.parametrize("scheme", ["adaptive", "implicit"])
def test_a_run_that_fails_by_deep_wear_asks_for_the_unit(scheme):
    for k, asks in ((1.2e-6, True), ("1.2e-3 mm3/(N m)", False)):
        end = washer(10.0).time.end
        fixed = {"time.scheme": scheme, "time.step": end / 2, "time.steps": 2, "time.end": None}
        case = washer(10.0, k, **(fixed if scheme == "implicit" else {}))
        with pytest.raises(rw.ComputationError, match="half of its height") as failure:
            rw.simulate(case, MPI.COMM_SELF)
        assert ('"1.2e-06 mm3/(N m)"' in str(failure.value)) == asks


@pytest.mark.parametrize(
    "load",
    [{}, {"load.control": "displacement", "load.pressure": None, "load.displacement": 0.5}],
)
def test_bodies_that_are_apart(load):
    keys = {"upper.z": [21, 41], "time.steps": 1, "mesh.contact_elements": 12, **load}
    (doubt,) = rw.simulate(rw.read_case(PAPER, keys), MPI.COMM_SELF).doubts
    assert "1 mm apart" in doubt.text
