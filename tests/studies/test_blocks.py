"""Cases of a pair computed together: the same results and columns whatever goes on beside them."""

import numpy as np
import pytest
from mpi4py import MPI
from swept import CASE

import ringwear_par as rw
from ringwear_par.cases.files.reading import parse_case
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.loop import simulate_one
from ringwear_par.results.execution.recorder import Recorder
from ringwear_par.results.execution.run import run_case
from ringwear_par.results.result import FailedResult, HistoryColumns
from ringwear_par.results.storage.result_files import restored
from ringwear_par.results.variables import HISTORIES
from ringwear_par.studies.execution.batches import computed
from ringwear_par.studies.execution.many import simulate_all

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
    ]  # fmt: skip
    return [case.replace({**change, **more}) for change in changes]


def test_results_do_not_depend_on_the_batch(case):
    """But for round-off."""
    cases = cases_of(case)
    for one, other in zip(
        simulate_all(cases, ALONE), simulate_all(cases, ALONE, batch=2), strict=True
    ):
        if isinstance(one, FailedResult):
            assert str(one.error) == str(other.error)
            continue
        assert np.array_equal(one.steps_made, other.steps_made)
        for name in ("approach", "worn_volume_lower"):
            exact = one.histories[name]
            assert np.abs(other.histories[name] - exact).max() <= 1e-9 * np.abs(exact).max()
        for name, values in one.profiles.items():
            assert np.abs(other.profiles[name] - values).max() <= 1e-9 * np.abs(values).max()


@pytest.mark.parametrize("profiles", ["all", "last"])
def test_results_are_those_of_single_cases(case, profiles):
    cases = cases_of(case, **{"output.profiles": profiles})
    for one, mine in zip(cases, simulate_all(cases, ALONE), strict=True):
        if isinstance(mine, FailedResult):
            with pytest.raises(rw.ComputationError) as caught:
                rw.simulate(one, ALONE)
            assert str(caught.value) == str(mine.error)
            continue
        exact = rw.simulate(one, ALONE)
        assert np.array_equal(mine.step, exact.step)
        for name, values in (exact.histories | exact.profiles).items():
            own = {**mine.histories, **mine.profiles}[name]
            assert own.shape == values.shape
            assert own.dtype == values.dtype
            if name == "contact_iterations":
                continue
            most = 1e-13 if name == "gap" else 1e-11 * np.abs(values).max()
            assert np.abs(own - values).max() <= most, name
        assert mine.attributes.keys() == exact.attributes.keys()
        assert mine.doubts == exact.doubts
        for name in ("case", "status", "scheme", "law_lower", "energy_identity", "begun_by"):
            assert mine.attributes[name] == exact.attributes[name]
        assert mine.balances.keys() == exact.balances.keys()
        assert max(mine.balances[n] for n in ("force", "volume", "energy", "residual")) < 1e-9


def test_what_is_stored_goes_on_as_any_run(case, tmp_path):
    """A result is saved, and a longer run goes on from it."""
    path, longer = tmp_path / "case.toml", tmp_path / "longer.toml"
    path.write_text(case.text)
    longer.write_text(case.replace({"time.steps": 10}).text)
    (found,) = simulate_all([rw.read_case(path)], ALONE)
    found.save(tmp_path / "run.h5")
    assert restored(found).progress.steps == 6
    run_case(longer, tmp_path / "run.h5", comm=ALONE, restart=True)
    whole = rw.simulate(rw.read_case(longer), ALONE)
    gone_on = rw.open_result(tmp_path / "run.h5")
    assert gone_on.attributes["status"] == "complete"
    wear = whole.profiles["wear_lower"][-1]
    assert np.abs(gone_on.profiles["wear_lower"][-1] - wear).max() <= 1e-11 * wear.max()


@pytest.mark.parametrize("profiles", ["all", "last"])
def test_columns_hold_what_results_do(case, profiles):
    """Failed and single ones among them, each history's rows together."""
    cases = cases_of(case, **{"output.profiles": profiles})
    pair, seen = assemble(case, ALONE), set()
    for block in computed(cases, pair, batch=3, results=True):
        columns = block.columns
        assert isinstance(columns, HistoryColumns)
        assert columns.offsets[-1] == len(columns.steps)
        for place, (number, result) in enumerate(zip(block.numbers, block.results(), strict=True)):
            seen.add(number)
            rows = columns.rows(place)
            if isinstance(result, Exception):
                assert columns.status[place] == "failed"
                assert columns.reason[place] == " ".join(str(result).split())
                # its start is stored before it fails
                assert columns.steps[rows].tolist() == [0]
                assert columns.flags[place] == ()
                continue
            assert columns.status[place] == "done"
            assert np.array_equal(columns.steps[rows], result.steps_made)
            for name in HISTORIES:
                assert np.array_equal(columns.histories[name][rows], result.histories[name])
                assert columns.histories[name].dtype == HISTORIES[name].dtype
            for name, values in columns.profiles.items():
                own = values[rows] if profiles == "all" else values[place]
                assert np.array_equal(own, result.profiles[name])
            worst = max(result.balances[n] for n in ("force", "volume", "energy", "residual"))
            assert columns.imbalance[place] == worst
            assert len(columns.flags[place]) == len(result.doubts)
            assert columns.seconds[place] > 0.0
    assert seen == set(range(len(cases)))


def test_flags_are_those_of_single_cases(case):
    """Of each history among others that have none, or others."""
    steep = {"time.scheme": "explicit", "time.step": 500.0, "time.steps": 2}
    cases = [case.replace(steep), case.replace({**steep, "time.step": 1e-3}),
             case.replace({"wear.lower.k": 1e-3, "time.steps": 3})]  # fmt: skip
    pair, found = assemble(case, ALONE), {}
    for block in computed(cases, pair):
        found.update(zip(block.numbers, block.columns.flags, strict=True))
    for i, one in enumerate(cases):
        recorder = Recorder([one], ALONE)
        simulate_one(one, ALONE, pair=pair, observers=[recorder])
        assert found[i] == tuple(doubt.code for doubt in recorder.result().doubts)
    assert "unstable_explicit_step" in found[0]
    assert "unstable_explicit_step" not in found[1]
