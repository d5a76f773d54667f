"""What users call from Python: the numbers of the command, errors, many cases, on any ranks."""

from dataclasses import replace

import numpy as np
import pytest
import xarray
from commands import on_ranks, python
from parts import ThresholdLaw, run_case
from paths import PAPER

import ringwear_par as rw

SMALL = {"mesh.contact_elements": 16, "time.steps": 10}
SET = [f"{key}={value}" for key, value in SMALL.items()]
#: what differs between two computations of the same
CLOCK = {f"seconds_{name}" for name in ("assembly", "factorisation", "stepping", "output")}


@pytest.fixture(scope="module")
def case():
    return rw.read_case(PAPER, SMALL)


@pytest.fixture(scope="module")
def pair(case, comm):
    return rw.assemble(case, comm)


def without_clock(dataset):
    return dataset.assign_attrs(dict.fromkeys(CLOCK, 0.0))


@pytest.mark.parametrize(
    "words",
    [
        {},
        {"time.scheme": "adaptive"},
        {"output.times": [0.5, 7.2]},
    ],
)
def test_simulate_gives_what_run_stores(case, tmp_path, comm, words):
    result = rw.simulate(case.replace(words), comm)
    path = tmp_path / "run.h5"
    keys = [*SET, *(f"{key}={value}" for key, value in words.items())]
    run_case(PAPER, path, keys, comm=comm)
    with xarray.open_dataset(path, engine="h5netcdf") as stored:
        xarray.testing.assert_identical(
            without_clock(stored.load()), without_clock(result.to_xarray())
        )


def test_a_pair_serves_any_load_law_and_modulus(case, pair, comm):
    for changes in (
        {"load.pressure": 50, "wear.lower.k": 3e-7},
        {"lower.young": 2e4},
        {"wear.upper": {"law": "archard", "k": 1e-9}, "load.omega": 1.0},
    ):
        other = case.replace(changes)
        with_pair, alone = rw.simulate(other, comm, pair=pair), rw.simulate(other, comm)
        for name in ("approach", "pressure", "wear_lower", "wear_upper"):
            assert np.array_equal(with_pair.to_xarray()[name], alone.to_xarray()[name]), name


def test_a_pair_of_another_shape_is_refused(case, pair, comm):
    with pytest.raises(rw.InputError, match="pair"):
        rw.simulate(case.replace({"upper.r": [28.0, 31.5]}), comm, pair=pair)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"friction": np.nan}, "contact.friction"),
        ({"wear_lower": ThresholdLaw(-1e-7)}, "wear.lower.k"),
    ],
)
def test_numbers_of_cases_that_were_not_read_are_checked(case, comm, changes, key):
    bad = replace(case, **changes)
    with pytest.raises(rw.InputError, match=key):
        rw.simulate(bad, comm)
    good, failed = rw.simulate_all([case, bad], comm)
    assert isinstance(good, rw.Result)
    assert key in str(failed.error)


def test_what_is_no_case_is_refused(case, comm):
    for wrong in ({"load": {}}, str(PAPER)):
        for call in (rw.simulate, rw.assemble):
            with pytest.raises(rw.InputError, match="read_case"):
                call(wrong, comm)
        with pytest.raises(rw.InputError, match=r"cases\[1\].*read_case"):
            rw.simulate_all([case, wrong], comm)
    with pytest.raises(rw.InputError, match="list of cases"):
        rw.simulate_all(case, comm)
    good, bad = rw.simulate_all([case, case.replace({"load.pressure": 1e9})], comm)
    with pytest.raises(rw.InputError, match="failed"):
        rw.plot([good, bad])


def test_dir_shows_what_is_public():
    assert [name for name in dir(rw) if not name.startswith("__")] == rw.__all__
    with pytest.raises(AttributeError, match="nothing"):
        _ = rw.nothing


@pytest.mark.parametrize("ranks", on_ranks(0, 2))
def test_three_lines_of_a_script(tmp_path, ranks):
    """With the world's communicator, which nobody mentions, and solvers that nobody frees."""
    program = f"""
import sys
import ringwear_par as rw
case = rw.read_case({str(PAPER)!r}, {SMALL!r})
assert not {{"mpi4py", "petsc4py"}} & set(sys.modules)
result = rw.simulate(case)
assert result.to_xarray().penetration[-1] > 0
result.save({str(tmp_path / "run.h5")!r})
"""
    done = python("-c", program, ranks=ranks)
    assert (done.returncode, done.stderr) == (0, "")
    with xarray.open_dataset(tmp_path / "run.h5", engine="h5netcdf") as data:
        assert data.attrs["ranks"] == max(ranks, 1)
