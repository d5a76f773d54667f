"""Adaptive steps: counts, accuracy, order, schedules, times of output, memory, restarts."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from changed_steps import change_steps
from parts import (
    Load,
    NonLocalLaw,
    Output,
    PowerLaw,
    RunningInLaw,
    Stepping,
    Table,
    ThresholdLaw,
    integral,
)
from reference_cases import OMEGA
from ringwear_par.history.observers.balances import balances
from ringwear_par.history.observers.trace import trace
from ringwear_par.history.physics import Physics

import ringwear_par as rw
from ringwear_par.history.schemes import sdirk2

FORCE = 45238.934


def until(end, tolerance=2e-6):
    return Stepping("adaptive", until=end, tolerance=tolerance)


@pytest.fixture
def stepped(paper_pair, comm):
    """Function that runs the paper's case with parts replaced: history, states, those shown."""

    def stepped(**parts):
        history = trace(replace(paper_pair[0], **parts), comm, pair=paper_pair[1])
        return history, history.states, history.passing

    return stepped


@pytest.mark.parametrize("p0", [0.0, 40.0])
def test_the_papers_case_in_few_steps(stepped, p0):
    """200 s within 0.01 um everywhere in 20 steps, 2000 s in 30, at the default tolerance."""
    law = ThresholdLaw(1e-7, p0)
    for end, most in ((200.0, 20), (2000.0, 30)):
        history, states, _ = stepped(time=Stepping("adaptive", until=end), wear_lower=law)
        _, exact, _ = stepped(time=until(end, 1e-7), wear_lower=law)
        last = states[-1]
        assert last.time == end
        assert history.steps <= most
        assert np.abs(last.wear - exact[-1].wear).max() <= 1e-5
        assert abs(last.contact.approach - exact[-1].contact.approach) <= 1e-5
        assert history.balances.worst <= 1e-9
        assert history.balances.volume <= 1e-12
        assert history.balances.energy <= 1e-12


def test_stages_are_of_second_order(stepped, paper_pair, comm):
    """Steps of equal length from a state that has left the singular transient behind."""
    case, pair = paper_pair
    case = replace(case, wear_lower=ThresholdLaw(1e-7), time=until(40.0, 1e-8))
    start = trace(case, comm, pair=pair).snapshots[-1].state
    physics = Physics.of([case], pair)
    with physics.contacts() as contacts:

        def wear(number):
            state = start
            for i in range(number):
                end = np.array([40.0 + 160.0 * (i + 1) / number])
                state = sdirk2.step(physics, contacts, state, end).state
            return state.wear[0]

        exact = wear(256)
        errors = [np.abs(wear(n) - exact).max() for n in (8, 16, 32)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 1.7).all(), orders


def test_times_of_output_are_as_accurate_and_change_nothing(stepped):
    times = (0.3, 20.0, 20.5, 117.0)
    _, plain, _ = stepped(time=until(200.0))
    history, states, shown = stepped(time=until(200.0), output=Output(times=times))
    assert [s.time for s in states] == pytest.approx([s.time for s in plain], rel=1e-9)
    assert states[-1].wear == pytest.approx(plain[-1].wear, rel=1e-9)
    stored = [s.stored for s in history.snapshots]
    assert stored == [True] + [False] * (len(states) - 2) + [True]
    assert [time for s in shown for time in s.state.time.tolist()] == list(times)
    assert all(s.stored.all() for s in shown)
    for time in times:
        state = history.at(time)
        _, exact, _ = stepped(time=until(time, 1e-7))
        assert np.abs(state.wear - exact[-1].wear).max() <= 1e-5
        assert state.contact.pressure == pytest.approx(exact[-1].contact.pressure, rel=0.03)
    for snapshot in shown:
        off = balances(snapshot.physics, snapshot.state)
        assert max(np.max(off[n]) for n in ("force", "volume", "energy", "residual")) <= 1e-9


def test_times_of_output_of_fixed_steps(stepped):
    times = (0.5, 7.0, 9.99)
    history, _, shown = stepped(time=Stepping("implicit", 1.0, 10), output=Output(times=times))
    assert [time for s in shown for time in s.state.time.tolist()] == [0.5, 9.99]
    assert [float(s.state.time[0]) for s in history.snapshots if s.stored] == [0.0, 7.0, 10.0]


SCHEMES = {
    "adaptive": until(100.0),
    "implicit": Stepping("implicit", 2.0, 50),
    "explicit": Stepping("explicit", 0.02, 5000),
}


@pytest.mark.parametrize("scheme", ["adaptive", "implicit"])
def test_no_wear_without_contact_or_sliding(stepped, scheme):
    """Stops, unloading to nothing, loading again."""
    omega = Table((0.0, 20.0, 20.1, 40.0, 40.1), (OMEGA, OMEGA, 0.0, 0.0, OMEGA))
    force = Table((0.0, 60.0, 61.0, 80.0, 81.0), (FORCE, FORCE, 0.0, 0.0, 1.5 * FORCE))
    law = ThresholdLaw(1e-7)
    history, states, _ = stepped(
        load=Load(omega, force), time=SCHEMES[scheme], wear_lower=law, wear_upper=law
    )
    assert states[-1].time == pytest.approx(100.0)
    assert history.balances.worst <= 1e-9
    assert history.balances.energy <= 1e-12  # of both bodies
    for before, after in itertools.pairwise(states):
        still = integral(omega, before.time, after.time) == 0.0
        loose = before.time >= 61.0 and after.time <= 80.0
        if still or loose:
            assert np.array_equal(before.wear, after.wear)
            assert after.energy == before.energy
        if loose:
            assert not after.contact.pressure.any()
            assert after.contact.gap.min() >= -1e-15
        force_now = np.interp(after.time, force.x, force.y)
        assert after.contact.force == pytest.approx(force_now, rel=1e-10)
    if scheme == "adaptive":  # steps end where tables bend
        assert {20.0, 20.1, 40.0, 40.1, 60.0, 61.0, 80.0, 81.0} <= {s.time for s in states}
    worn = [np.interp(t, [s.time for s in states], [s.wear[0].max() for s in states])
            for t in (60.0, 80.0, 100.0)]  # fmt: skip
    assert worn[0] > 0
    assert worn[1] == pytest.approx(worn[0], rel=0.05)
    assert worn[2] > 1.1 * worn[1]


def test_sliding_distance_of_fixed_steps_is_exact(stepped):
    """Pulses of omega far shorter than a step wear as much as their angle says (p0 = 0)."""
    pulses = Table((0.0, 10.0, 10.1, 10.2, 10.3), (0.0, 0.0, 50.0, 50.0, 0.0))
    law, angle = ThresholdLaw(1e-13), 50.0 * 0.2
    history, states, _ = stepped(
        load=Load(pulses, FORCE), time=Stepping("implicit", 4.0, 5), wear_lower=law
    )
    # so little wear leaves the pressure alone
    p, line = states[0].contact.pressure, history.physics.line
    assert states[-1].wear[0] == pytest.approx(1e-14 * p * line.arm * angle, rel=1e-3)


def test_displacement_that_comes_and_goes(stepped):
    down = Table((0.0, 20.0, 40.0, 60.0), (0.0, 0.05, 0.0, 0.06))
    history, states, _ = stepped(
        load=Load(OMEGA, displacement=down), time=until(60.0), wear_lower=ThresholdLaw(1e-7)
    )
    by_time = {s.time: s for s in states}
    assert not by_time[0.0].contact.pressure.any()
    assert not by_time[40.0].contact.pressure.any()  # lifted off
    assert by_time[20.0].contact.force > 0
    assert by_time[40.0].contact.gap.min() > 0
    assert states[-1].contact.approach == 0.06
    assert history.balances.worst <= 1e-9


@pytest.mark.parametrize(
    "law",
    [
        PowerLaw(2e-10, 1.7, 1.2),
        RunningInLaw(5e-8, 4e-7, 20.0, depth=0.002),
        RunningInLaw(5e-8, 4e-7, 20.0, distance=3000.0),
        NonLocalLaw(1e-7, 40.0, length=0.2),
    ],
)
def test_other_laws_converge_to_the_same_from_all_schemes(stepped, law):
    _, exact, _ = stepped(time=until(60.0, 1e-7), wear_lower=law)
    _, coarse, _ = stepped(time=until(60.0), wear_lower=law)
    size = exact[-1].wear.max()
    assert np.abs(coarse[-1].wear - exact[-1].wear).max() <= max(1e-5, 2e-3 * size)
    errors = []
    for number in (50, 100):
        history, fixed, _ = stepped(
            time=Stepping("implicit", 60.0 / number, number), wear_lower=law
        )
        errors.append(np.abs(fixed[-1].wear - exact[-1].wear).max())
        assert history.balances.worst <= 1e-9
    assert errors[1] < 0.75 * errors[0] or errors[1] < 2e-5
    assert errors[1] < 0.02 * size


@pytest.mark.parametrize("fault", ["contact: no", "errors exceed"])
def test_a_tolerance_that_cannot_be_met_is_an_error(stepped, monkeypatch, fault):
    def failing(step, *arguments):
        if fault == "errors exceed":
            return replace(step(*arguments), wear_error=np.ones(1))
        raise rw.ComputationError(fault)

    change_steps(monkeypatch, failing)
    with pytest.raises(rw.ComputationError, match=fault):
        stepped(time=until(10.0))
