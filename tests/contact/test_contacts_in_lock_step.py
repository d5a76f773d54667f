"""Many contact problems at once: each meets its conditions, and has what it has alone."""

import numpy as np
import pytest
from one_contact import OneContact
from parts import (
    HistoriesError,
    NonLocalLaw,
    PowerLaw,
    ThresholdLaw,
    WearIncrement,
    averaging,
    stack_laws,
)

import ringwear_par as rw
from ringwear_par.contact.engine import TAO_TYPES, ContactEngine
from ringwear_par.contact.problem import KKT_TOLERANCE
from ringwear_par.contact.scaled_compliances import ScaledCompliances

N, B = 19, 11
R = np.linspace(28.5, 31.5, N)
AREA = 2 * np.pi * R * np.gradient(R)
RNG = np.random.default_rng(5)
#: mm^3/MPa, of two pairs of moduli
COMPLIANCES = np.array(
    [c * AREA[:, None] * AREA * np.exp(-np.abs(R[:, None] - R)) for c in (1e-6, 3e-6)]
)
WHICH = np.arange(B) % 2
CROWN = 1e-3 * (R - 30.0) ** 2
GAP = CROWN + RNG.uniform(0.0, 1e-5, (B, N))
FORCE = 10.0 ** RNG.uniform(1.0, 5.0, B)
LAWS = {
    "threshold": [ThresholdLaw(k, p0) for k, p0 in zip(RNG.uniform(1e-8, 1e-6, B),
                                                       RNG.uniform(0, 40, B), strict=True)],
    "power": [PowerLaw(k, 1.7) for k in RNG.uniform(1e-10, 1e-9, B)],
    "non-local": [NonLocalLaw(k, length=0.3) for k in RNG.uniform(1e-8, 1e-6, B)],
}  # fmt: skip


def wear_of(name):
    """The wear of an implicit step of B histories."""
    laws = LAWS[name]
    speed = np.linspace(80.0, 120.0, B)[:, None] * np.ones(N)
    at = rw.LocalState(np.zeros(B), R, speed, np.full(B, 0.1), np.zeros((B, N)), 0.0 * speed)
    average = averaging(R, AREA, laws[0].length) if laws[0].length else None
    return WearIncrement((stack_laws(laws), None), (at, at), np.linspace(1.0, 5.0, B),
                         (average, None))  # fmt: skip


def engine_of(tao_type=None):
    """An engine of histories that have these compliances."""
    return ContactEngine(ScaledCompliances.of(COMPLIANCES, AREA), WHICH, tao_type)


@pytest.fixture
def solver():
    with engine_of() as engine:
        yield engine


def load_of(control):
    return {control: {"force": FORCE, "approach": np.linspace(-1e-3, 4e-3, B)}[control]}


@pytest.mark.parametrize("name", [None, *LAWS])
@pytest.mark.parametrize("control", ["force", "approach"])
@pytest.mark.parametrize("way", ["ours", *TAO_TYPES[1:]])
def test_every_history_meets_its_conditions(comm, name, control, way):
    """Pressures >= 0, gaps >= 0, one of them 0, the load; and as it is found alone."""
    ours = way == "ours"
    wear, load = None if name is None else wear_of(name), load_of(control)
    with engine_of(None if ours else way) as engine:
        found = engine.solve(GAP, **load, wear=wear)
    touched = 0
    for i in range(B):
        own = None if wear is None else wear.take(np.array([i]))
        p = found.pressure[i]
        gap = GAP[i] - found.approach[i] + COMPLIANCES[WHICH[i]] @ p / AREA
        gap += 0.0 if own is None else own.depth(p[None])[0]
        size = np.abs(GAP[i] - found.approach[i]).max()
        assert (p >= 0.0).all()
        assert gap.min() >= -1e-9 * size
        assert np.abs(np.where(p > 0.0, gap, 0.0)).max() <= 1e-9 * size
        assert np.abs(found.gap[i] - gap).max() <= 1e-9 * size
        touched += 0 < np.count_nonzero(p) < N
        if control == "force":
            assert AREA @ p == pytest.approx(FORCE[i], rel=1e-12 if ours else 1e-10)
        with OneContact(COMPLIANCES[WHICH[i]], AREA) as single:
            exact = single.solve(GAP[i], **{control: load[control][i]}, wear=own)
        assert np.abs(p - exact.pressure).max() <= 1e-9 * max(exact.pressure.max(), 1e-300)
        assert found.approach[i] == pytest.approx(exact.approach, rel=1e-9)
    assert touched > 2  # some are in partial contact
    assert found.residual.max() <= KKT_TOLERANCE


def test_no_force_is_no_pressure(solver):
    """The bodies just touch; and what comes after starts from there."""
    force = np.where(np.arange(B) == 4, 0.0, FORCE)
    for given in (force, FORCE, force):
        found = solver.solve(GAP, force=given, wear=wear_of("power"))
        assert found.force == pytest.approx(given, rel=1e-12)
    assert found.approach[4] == GAP[4].min()
    assert not found.pressure[4].any()
    assert not solver.response(GAP)[4].any()


def test_contacts_that_cannot_be_solved_are_named(solver):
    gap = GAP.copy()
    gap[[2, 7]] = np.nan
    with pytest.raises(HistoriesError) as caught:
        solver.solve(gap, force=FORCE)
    assert np.flatnonzero(caught.value.which).tolist() == [2, 7]


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("control", ["force", "approach"])
def test_responses_are_differences(solver, name, control):
    """To the hundredths that estimates of errors need; nobody gains or loses contact."""
    wear, load = wear_of(name), load_of(control)
    change = 1e-9 * RNG.uniform(0.5, 1.0, (B, N))
    before = solver.solve(GAP, **load, wear=wear)
    response = solver.response(change)
    after = solver.solve(GAP + change, **load, wear=wear)
    same_set = ((before.pressure > 0.0) == (after.pressure > 0.0)).all(axis=1)
    assert np.count_nonzero(same_set) > B // 2
    found = (after.pressure - before.pressure)[same_set]
    size = np.abs(found).max(axis=1, keepdims=True)
    size += 1e-9 * before.pressure[same_set].max(axis=1, keepdims=True)
    assert (np.abs(found - response[same_set]) <= 0.05 * size).all()
