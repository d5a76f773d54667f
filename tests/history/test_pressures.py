"""Pressures of adaptive steps while contact grows: a crowned ring and a sphere that wear in."""

from dataclasses import replace

import numpy as np
import pytest
from parts import ArchardLaw, Closing, Output, WearIncrement
from paths import CASES
from ringwear_par.history.observers.trace import trace

import ringwear_par as rw
from ringwear_par.history.elastic import assemble

SPHERE = {"time": None, "time.scheme": "adaptive", "time.end": 200.0}


def compared(case, comm, tolerance):
    """Return a history and the states of a far finer one at the same times."""
    pair = assemble(case, comm)
    history = trace(case, comm, pair=pair)
    finer = replace(case.time, tolerance=tolerance, pressure_tolerance=np.inf)
    output = Output(times=tuple(state.time for state in history.states[1:]))
    exact = trace(replace(case, time=finer, output=output), comm, pair=pair)
    return history, [(s, exact.at(s.time)) for s in history.states[1:]]


def pressure_errors(pairs):
    """Return the largest error of pressure of each state, relative to its largest pressure."""
    return np.array(
        [
            np.abs(s.contact.pressure - e.contact.pressure).max() / e.contact.pressure.max()
            for s, e in pairs
        ]
    )


def test_the_crown_has_no_peaks_where_contact_grows(comm):
    case = rw.read_case(CASES / "crown.toml", {"mesh.contact_elements": 64, "time.end": 300.0})
    history, pairs = compared(case, comm, 1e-7)
    errors = pressure_errors(pairs)
    loose = replace(case, time=replace(case.time, pressure_tolerance=1e3))
    assert errors.max() < 0.25  # stages that know nothing of entering elements: 1.4
    assert np.median(errors) < 0.1
    assert history.steps <= 4 * trace(loose, comm).steps
    assert history.balances.worst <= 1e-9
    assert history.balances.volume <= 1e-12
    assert history.balances.energy <= 1e-12


def test_a_smaller_tolerance_of_pressure_is_more_accurate(comm):
    errors = []
    for tolerance in (0.3, 0.03):
        changes = {"mesh.contact_elements": 32, "time.end": 100.0,
                   "time.pressure_tolerance": tolerance}  # fmt: skip
        _, pairs = compared(rw.read_case(CASES / "crown.toml", changes), comm, 1e-7)
        errors.append(pressure_errors(pairs))
    assert np.median(errors[1]) < 0.7 * np.median(errors[0])
    assert errors[1].max() < errors[0].max()


def test_the_spheres_penetration_does_not_wobble(comm):
    case = rw.read_case(CASES / "sphere.toml", {**SPHERE, "mesh.contact_elements": 48})
    _, pairs = compared(case, comm, 1e-7)
    assert pressure_errors(pairs).max() < 0.05
    approach, exact = (np.array([pair[i].contact.approach for pair in pairs]) for i in (0, 1))
    assert np.abs(approach / exact - 1.0).max() < 1e-3


def test_wear_that_closes_a_gap_first():
    """Depth, its derivative and its potential go together, and gap and wear are those of a step."""
    p = np.array([0.0, 1.0, 2.0, 5.0, 5.0])
    nothing = np.zeros(5)
    at = rw.LocalState(0.0, np.full(5, 12.0), np.full(5, 10.0), 0.1, nothing, nothing)
    closing = Closing(np.array([1e-6, 1e-6, 3e-6, 3e-6, 0.0]), np.full(5, 2.0))
    laws = ArchardLaw(1e-7), ArchardLaw(5e-8)
    wear = WearIncrement(laws, (at, at), 2.0, closing=closing)
    plain = WearIncrement(laws, (at, at), 2.0)
    assert wear.depth(p) == pytest.approx(np.maximum(plain.depth(p) - closing.gap, 0.0))
    assert wear.depths(p).sum(axis=0) == pytest.approx(wear.depth(p), rel=1e-12)
    worn = wear.depth(p) > 0.0
    assert wear.d_depth_dp(p)[worn] == pytest.approx(plain.d_depth_dp(p)[worn])
    assert not wear.d_depth_dp(p)[~worn].any()
    slope = (wear.potential(p + 1e-4) - wear.potential(p - 1e-4)) / 2e-4
    assert slope[1:] == pytest.approx(wear.depth(p)[1:], rel=1e-6, abs=1e-16)
