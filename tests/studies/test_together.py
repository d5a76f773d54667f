"""Cases of a pair computed together: the results of single runs, whatever goes on beside them."""

import numpy as np
import pytest
from agreement import assert_agree
from mpi4py import MPI
from parts import parse_case, restored, run_case
from swept import CASE

import ringwear_par as rw
from ringwear_par.studies.many import simulate_all

ALONE = MPI.COMM_SELF


@pytest.fixture(scope="module")
def case():
    return parse_case(CASE, "case", {"time.steps": 6, "output.every": 2})


def cases_of(case, **more):
    """Cases that differ in numbers; one fails, and some stay alone."""
    changes = [
        {"wear.lower.k": 2e-7}, {"load.pressure": 50.0, "time.steps": 3}, {"wear.lower.k": 0.5},
        {"wear.lower.p0": 0.0}, {"wear.lower.k": 2e-7}, {"upper.young": 5e4},
        {"mesh.geometry": "updated"}, {"time.scheme": "explicit"},
        {"load.pressure": [[0, 9], [9, 90]]},
        {"time.scheme": "explicit", "time.step": 500.0, "time.steps": 2},
    ]  # fmt: skip
    return [case.replace({**change, **more}) for change in changes]


def test_results_do_not_depend_on_the_batch(case):
    """But for round-off."""
    cases = cases_of(case)
    for one, other in zip(
        simulate_all(cases, ALONE), simulate_all(cases, ALONE, batch=2), strict=True
    ):
        if isinstance(one, rw.FailedResult):
            assert str(one.error) == str(other.error)
            continue
        assert np.array_equal(one.steps_made, other.steps_made)
        for name, exact in (one.histories | one.profiles).items():
            if name == "contact_iterations":
                continue
            values = (other.histories | other.profiles)[name]
            assert np.abs(values - exact).max() <= 1e-9 * max(np.abs(exact).max(), 1e-3), name


@pytest.mark.parametrize("profiles", ["all", "last"])
def test_results_are_those_of_single_cases(case, profiles):
    cases = cases_of(case, **{"output.profiles": profiles})
    results = simulate_all(cases, ALONE)
    for one, mine in zip(cases, results, strict=True):
        if isinstance(mine, rw.FailedResult):
            with pytest.raises(rw.ComputationError) as caught:
                rw.simulate(one, ALONE)
            assert str(caught.value) == str(mine.error)
            continue
        exact = rw.simulate(one, ALONE)
        if one is not cases[-1]:  # whose steps are unstable
            assert_agree(mine, exact)
        assert [doubt.code for doubt in mine.doubts] == [doubt.code for doubt in exact.doubts]
        assert mine.attributes.keys() == exact.attributes.keys()
        for name in ("case", "status", "scheme", "law_lower", "energy_identity"):
            assert mine.attributes[name] == exact.attributes[name]
        assert mine.balances.keys() == exact.balances.keys()
        assert max(mine.balances[n] for n in ("force", "energy")) < 1e-9
        assert mine.balances["residual"] < 2e-4
    assert results[-1].doubts
    assert results[0].balances["residual"] > 1e-9  # of a block
    assert not results[0].doubts
    assert isinstance(results[2], rw.FailedResult)


def test_what_is_stored_goes_on_as_any_run(case, tmp_path):
    """A result is saved, and a longer run goes on from it."""
    path, longer = tmp_path / "case.toml", tmp_path / "longer.toml"
    path.write_text(case.text)
    longer.write_text(case.replace({"time.steps": 10}).text)
    (found,) = simulate_all([rw.read_case(path)], ALONE)
    found.save(tmp_path / "run.h5")
    assert restored(found).steps == 6
    run_case(longer, tmp_path / "run.h5", comm=ALONE, restart=True)
    whole = rw.simulate(rw.read_case(longer), ALONE)
    gone_on = rw.open_result(tmp_path / "run.h5")
    assert gone_on.attributes["status"] == "complete"
    assert_agree(gone_on, whole)
