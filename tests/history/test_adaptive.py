"""Adaptive steps: counts, accuracy, schedules, times of output, growing contacts."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from parts import (
    Load,
    Mesh,
    Output,
    PowerLaw,
    RunningInLaw,
    Stepping,
    Table,
    ThresholdLaw,
    integral,
)
from paths import CASES
from reference_cases import OMEGA, paper_case
from tracing import ALONE, trace

import ringwear_par as rw
from ringwear_par.history.elastic import assemble

FORCE = 45238.934


def until(end, tolerance=2e-6):
    return Stepping("adaptive", until=end, tolerance=tolerance)


@pytest.fixture
def stepped(paper_pair):
    """Function that runs the paper's case with parts replaced."""

    def stepped(**parts):
        return trace(replace(paper_pair[0], **parts), paper_pair[1])

    return stepped


@pytest.mark.parametrize("p0", [0.0, 40.0])
def test_the_papers_case_in_few_steps(stepped, p0):
    """200 s in 30 steps, 2000 s in 40, at the default tolerance, which they keep."""
    law = ThresholdLaw(1e-7, p0)
    for end, most in ((200.0, 30), (2000.0, 40)):
        history = stepped(time=Stepping("adaptive", until=end), wear_lower=law)
        exact, last = stepped(time=until(end, 1e-7), wear_lower=law).last, history.last
        tolerance = history.block.tolerance[0]
        assert last.time == end
        assert history.steps <= most
        assert np.abs(last.wear - exact.wear).max() <= tolerance
        assert abs(last.approach - exact.approach) <= tolerance
        assert history.balances.force <= 1e-8
        assert history.balances.energy <= 1e-12


LAWS = {
    "threshold": ThresholdLaw(1e-7, 40.0),
    "memory": RunningInLaw(5e-8, 4e-7, 20.0, depth=0.002),
    "power": PowerLaw(2e-10, 1.7, 1.2),
}


@pytest.mark.parametrize("name", LAWS)
def test_errors_fall_as_the_tolerance_does(name):
    """By its power 2/3 at least, as errors of steps are held; 10 nm is kept in all steps."""
    case = replace(paper_case(Mesh(32)), wear_lower=LAWS[name])
    pair, tolerances, off = assemble(case, ALONE), np.array([1e-5, 2.5e-6, 6.25e-7]), []
    for tolerance in tolerances:
        found = trace(replace(case, time=until(400.0, tolerance)), pair)
        times = Output(times=tuple(found.times[1:]))
        exact = trace(replace(case, time=until(400.0, 0.02 * tolerance), output=times), pair)
        errors = [np.abs(s.wear - exact.at(s.time).wear).max() for s in found.states[1:]]
        off.append(max(errors))
        assert 0.0 < found.balances.step_error <= tolerance
    assert 0.1 < off[0] / tolerances[0] < 1.0
    assert 0.5 < np.polyfit(np.log(tolerances), np.log(off), 1)[0] < 1.2


def test_steps_end_at_times_of_output(stepped):
    """And at no others than without them, but for the steps about them; each is as accurate."""
    times, end = (0.3, 20.0, 20.5, 117.0), 200.0
    plain = stepped(time=until(end))
    history = stepped(time=until(end), output=Output(times=times))
    assert set(times) <= set(history.times)
    assert plain.steps <= history.steps <= plain.steps + 3 * len(times)
    assert history.last.wear == pytest.approx(plain.last.wear, abs=2e-6)
    result = rw.simulate(replace(history.block.cases.every[0], mesh=Mesh(16)))
    assert result.histories["time"].tolist() == [0.0, *times, end]
    for time in times:
        state, exact = history.at(time), stepped(time=until(time, 1e-7)).last
        assert np.abs(state.wear - exact.wear).max() <= 2e-6
        assert state.pressure == pytest.approx(exact.pressure, rel=0.03)


STEPPINGS = {
    "adaptive": until(100.0),
    "implicit": Stepping("implicit", 2.0, 50),
    "explicit": Stepping("explicit", 0.1, 1000),
}


@pytest.mark.parametrize("scheme", STEPPINGS)
def test_no_wear_without_contact_or_sliding(scheme):
    """Stops, unloading to nothing, loading again."""
    omega = Table((0.0, 20.0, 20.1, 40.0, 40.1), (OMEGA, OMEGA, 0.0, 0.0, OMEGA))
    force = Table((0.0, 60.0, 61.0, 80.0, 81.0), (FORCE, FORCE, 0.0, 0.0, 1.5 * FORCE))
    case = paper_case(Mesh(16, grading=1.0), p0=(0.0, 0.0), stepping=STEPPINGS[scheme])
    history = trace(replace(case, load=Load(omega, force)))
    states = history.states
    assert states[-1].time == pytest.approx(100.0)
    assert history.balances.force <= 1e-8
    assert history.balances.energy <= 1e-12  # of both bodies
    for before, after in itertools.pairwise(states):
        still = integral(omega, before.time, after.time) == 0.0
        loose = before.time >= 61.0 and after.time <= 80.0
        if still or loose:
            assert np.array_equal(before.wear, after.wear)
            assert after.energy == before.energy
        if loose:
            assert not after.pressure.any()
            assert after.gap.min() >= -1e-15
        assert after.force == pytest.approx(np.interp(after.time, force.x, force.y), rel=1e-8)
    if scheme == "adaptive":  # steps end where tables bend
        assert {20.0, 20.1, 40.0, 40.1, 60.0, 61.0, 80.0, 81.0} <= set(history.times)
    worn = np.interp([60.0, 80.0, 100.0], history.times, [s.wear[0].max() for s in states])
    assert worn[0] > 0
    assert worn[1] == pytest.approx(worn[0], rel=0.05)
    assert worn[2] > 1.1 * worn[1]


def test_displacement_that_comes_and_goes(stepped):
    down = Table((0.0, 20.0, 40.0, 60.0), (0.0, 0.05, 0.0, 0.06))
    history = stepped(
        load=Load(OMEGA, displacement=down), time=until(60.0), wear_lower=ThresholdLaw(1e-7)
    )
    assert not history.at(0.0).pressure.any()
    assert not history.at(40.0).pressure.any()  # lifted off
    assert history.at(20.0).force > 0
    assert history.at(40.0).gap.min() > 0
    assert history.last.approach == 0.06
    assert history.balances.energy <= 1e-12


def compared(name, changes, tolerance):
    """Return a history and the states of a far finer one at the same times."""
    case = rw.read_case(CASES / f"{name}.toml", changes)
    pair = assemble(case, ALONE)
    history = trace(case, pair)
    output = Output(times=tuple(history.times[1:]))
    finer = replace(case, time=replace(case.time, tolerance=tolerance), output=output)
    exact = trace(finer, pair)
    return history, [(s, exact.at(s.time)) for s in history.states[1:]]


def pressure_errors(pairs):
    """Return the largest error of pressure of each state, relative to its largest pressure."""
    return np.array([np.abs(s.pressure - e.pressure).max() / e.pressure.max() for s, e in pairs])


def test_the_crown_has_no_peaks_where_contact_grows():
    """But on elements that have just touched: stages know nothing of the time of it."""
    history, pairs = compared("crown", {"mesh.contact_elements": 64, "time.end": 300.0}, 1e-7)
    errors = pressure_errors(pairs)
    assert np.quantile(errors, 0.9) < 0.3
    assert np.median(errors) < 0.1
    assert history.balances.energy <= 1e-12


def test_the_spheres_penetration_does_not_wobble():
    changes = {"time": None, "time.scheme": "adaptive", "time.end": 200.0,
               "mesh.contact_elements": 48}  # fmt: skip
    _, pairs = compared("sphere", changes, 1e-7)
    assert pressure_errors(pairs).max() < 0.05
    approach, exact = (np.array([pair[i].approach for pair in pairs]) for i in (0, 1))
    assert np.abs(approach / exact - 1.0).max() < 1e-3
