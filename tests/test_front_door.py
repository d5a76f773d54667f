"""What users call from Python: the numbers of the command, errors, many cases, on any ranks."""

import re
from dataclasses import replace

import numpy as np
import pytest
import xarray
from commands import python
from paths import PAPER

import ringwear_par as rw
from ringwear_par.results.execution.run import run_case

pytestmark = pytest.mark.serial

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
        pytest.param({"time.scheme": "adaptive"}, marks=pytest.mark.ranks),
        {"output.times": [0.5, 7.2]},
    ],
)
def test_simulate_gives_what_run_stores(case, shared_path, comm, words):
    result = rw.simulate(case.replace(words), comm)
    path = shared_path / "run.h5"
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
    with pytest.raises(rw.InputError, match="pair: was assembled for another shape"):
        rw.simulate(case.replace({"upper.r": [28.0, 31.5]}), comm, pair=pair)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"friction": -1.0}, "contact.friction = -1: must be "),
        ({"friction": np.nan}, "contact.friction = nan: must be "),
        ({"lower": {"young": -1.0}}, "lower.young = -1: must be "),
        ({"wear_lower": {"k": -1e-7}}, "wear.lower.k = -1e-07: must be "),
    ],
)
def test_numbers_of_cases_that_were_not_read_are_checked(case, comm, changes, said):
    parts = {
        name: replace(getattr(case, name), **change) if isinstance(change, dict) else change
        for name, change in changes.items()
    }
    bad = replace(case, **parts)
    with pytest.raises(rw.InputError, match=f"^case: {re.escape(said)}"):
        rw.simulate(bad, comm)
    good, failed = rw.simulate_all([case, bad], comm)
    assert isinstance(good, rw.Result)
    assert said in str(failed.error)


@pytest.mark.parametrize("batch", [0, -1, 2.5, 2.0, True, "2"])
def test_simulate_all_refuses_a_batch_that_is_no_count(case, comm, batch):
    with pytest.raises(rw.InputError, match=f"batch = {batch!r}: must be a whole number >= 1"):
        rw.simulate_all([case], comm, batch=batch)


def test_what_is_no_case_is_told_what_makes_one(case, comm):
    words = "{}: a Case is needed, not {}; read_case reads a file or a dict"
    for wrong, kind in (({"load": {}}, "dict"), (str(PAPER), "str")):
        with pytest.raises(rw.InputError, match=words.format("simulate", kind)):
            rw.simulate(wrong, comm)
        with pytest.raises(rw.InputError, match=words.format("assemble", kind)):
            rw.assemble(wrong, comm)
        with pytest.raises(rw.InputError, match=words.format(r"simulate_all: cases\[1\]", kind)):
            rw.simulate_all([case, wrong], comm)
    for wrong in (case, str(PAPER)):
        with pytest.raises(rw.InputError, match="simulate_all: a list of cases is needed, not"):
            rw.simulate_all(wrong, comm)
    with pytest.raises(rw.InputError, match=r"^study: case is a Case; must be"):
        rw.read_study({"case": case, "vary": {}})


def test_plot_tells_what_it_cannot_draw(case, comm, tmp_path):
    good, bad = rw.simulate_all([case, case.replace({"load.pressure": 1e9})], comm)
    for wrong, number in (([good, bad], 2), (bad, 1)):
        with pytest.raises(rw.InputError, match=rf"^plot: result {number} failed \(.* half of"):
            rw.plot(wrong)
    with pytest.raises(rw.InputError, match="plot: result 2 is a Case; must be a result"):
        rw.plot([good, case])
    with pytest.raises(rw.InputError, match="is a folder; must be the only thing to be drawn"):
        rw.plot([good, tmp_path])
    for outcome, pictures in (
        ("fit", "pictures fit.png and parameters.png are"), ("design", "picture design.png is"),
    ):  # fmt: skip
        (tmp_path / outcome).mkdir()
        (tmp_path / outcome / f"{outcome}.json").write_text("{}")
        said = (
            rf"{outcome}: is the folder of a {outcome}, whose {pictures} there .* ringwear report"
        )
        for given in (tmp_path / outcome, [str(tmp_path / outcome), good]):
            with pytest.raises(rw.InputError, match=said):
                rw.plot(given)


def test_what_is_shown_of_objects_is_short(case, pair, comm):
    line = r"16 \w*\s?elements, r = 28\.5 to 31\.5 mm>"
    assert re.fullmatch(f"<ContactPair: {line}", repr(pair))
    result = rw.simulate(case, comm, pair=pair)
    assert repr(result) == (
        f"<Result: {case.title} (result in memory): 16 contact elements, 11 states of 10 steps "
        "until 10 s, complete>"
    )
    assert repr(result.line) == "<ContactLine: 16 elements, r = 28.5 to 31.5 mm>"
    failed = rw.FailedResult(case.text, rw.ComputationError("step 3: no"))
    assert repr(failed) == f"<FailedResult: {case.title}: ComputationError: step 3: no>"
    study = rw.read_study({"case": str(PAPER), "vary": {"load.pressure": {"values": [40, 80]}}})
    assert repr(case).startswith(f"<Case {case.title!r}: lower r = 20 to 40 mm, upper r = 28.5 to")
    assert len(repr(result.checkpoint)) < 2000
    assert repr(study) == "<Study study: grid, cases: 2, operators: 1, varied: load.pressure>"


def test_dir_shows_what_is_public():
    assert [name for name in dir(rw) if not name.startswith("__")] == rw.__all__


@pytest.mark.parametrize("ranks", [0, 2])
def test_three_lines_of_a_script(tmp_path, ranks):
    """With the world's communicator, which nobody mentions, and solvers that nobody frees."""
    program = f"""
import ringwear_par as rw
case = rw.read_case({str(PAPER)!r}, {SMALL!r})
result = rw.simulate(case)
assert result.to_xarray().penetration[-1] > 0
result.save({str(tmp_path / "run.h5")!r})
rw.plot(result, "wear").savefig({str(tmp_path / "wear.png")!r}) if ranks_are_one() else None
""".replace(
        "import ringwear_par as rw",
        "import ringwear_par as rw\n\ndef ranks_are_one():\n"
        "    from mpi4py import MPI\n    return MPI.COMM_WORLD.size == 1",
    )
    done = python("-c", program, ranks=ranks)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    with xarray.open_dataset(tmp_path / "run.h5", engine="h5netcdf") as data:
        assert data.attrs["ranks"] == max(ranks, 1)
    assert (tmp_path / "wear.png").exists() == (ranks == 0)
