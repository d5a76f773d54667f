"""Many contact problems in lock step: optimality, and the inverses behind it."""

import numpy as np
import pytest
from one_contact import OneContact

from ringwear_par.contact import hessians
from ringwear_par.contact.engine import TAO_TYPES, ContactEngine
from ringwear_par.contact.problem import KKT_TOLERANCE
from ringwear_par.contact.scaled_compliances import ScaledCompliances
from ringwear_par.errors import HistoriesError
from ringwear_par.wear.increment import WearIncrement
from ringwear_par.wear.law import stack_laws
from ringwear_par.wear.laws.non_local import NonLocalLaw, averaging
from ringwear_par.wear.laws.power import PowerLaw
from ringwear_par.wear.laws.threshold import ThresholdLaw
from ringwear_par.wear.local_state import LocalState

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
    at = LocalState(np.zeros(B), R, speed, np.full(B, 0.1), np.zeros((B, N)), 0.0 * speed)
    average = averaging(R, AREA, laws[0].length) if laws[0].length else None
    return WearIncrement((stack_laws(laws), None), (at, at), np.linspace(1.0, 5.0, B),
                         (average, None))  # fmt: skip


def engine_of(which, tao_type=None):
    """An engine of histories that have these compliances."""
    return ContactEngine(ScaledCompliances.of(COMPLIANCES, AREA), which, tao_type)


@pytest.fixture
def solver():
    with engine_of(WHICH) as engine:
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
    with engine_of(WHICH, None if ours else way) as engine:
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
        error = 2e-11 if ours else 1e-9
        assert np.abs(p - exact.pressure).max() <= error * max(exact.pressure.max(), 1e-300)
        assert found.approach[i] == pytest.approx(exact.approach, rel=error)
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
    assert not solver.derivatives.response(GAP)[4].any()


def test_who_cannot_be_solved_is_named(solver):
    gap = GAP.copy()
    gap[[2, 7]] = np.nan
    with pytest.raises(HistoriesError) as caught:
        solver.solve(gap, force=FORCE)
    assert np.flatnonzero(caught.value.which).tolist() == [2, 7]


def hessians_of(n, count):
    """Hessians of two compliances, n elements, with slopes in proportion to speeds on some."""
    base = np.exp(-np.abs(np.subtract.outer(np.arange(n), np.arange(n))) / 5.0)
    area, which = RNG.uniform(1.0, 2.0, n), np.arange(count) % 2
    speed = RNG.uniform(1.0, 2.0, (2, n))
    compliances = ScaledCompliances.of(np.array([base, 2.0 * base]), area, speed)
    made = hessians.Hessians(compliances, which)
    shape = compliances.speed[which]
    made.blocks.slopes[:] = np.where(RNG.uniform(size=(count, n)) < 0.7, shape, 0.0)
    made.blocks.slopes[::3] *= RNG.uniform(0.0, 1e3, (len(made.blocks.slopes[::3]), 1))
    return made, compliances.matrices, compliances.weights[which]


@pytest.mark.parametrize("n", [1, 7, 8, 37, 64])
@pytest.mark.parametrize("kind", ["speed", "any shape", "coupled"])
def test_inverses_are_those_of_each_system(n, kind):
    """On the elements in contact; steps carry the force that is missing."""
    made, matrices, weights = hessians_of(n, 16)
    free = RNG.uniform(size=(16, n)) < 0.8
    free[1] = free[:, 0] = True
    if kind == "any shape":
        made.blocks.slopes[:] = RNG.uniform(0.0, 1.0, (16, n))
    if kind == "coupled":
        coupling = RNG.uniform(-0.01, 0.01, (16, n, n))
        made.coupling = coupling + coupling.transpose(0, 2, 1)
    asked, right, missing = np.array([0, 1, 6, 9, 15]), RNG.normal(size=(5, n)), np.arange(5.0)
    made.refresh(asked, free)
    out = made.solve(asked, np.array([right, 2.0 * right]))
    steps, changes = made.steps(asked, right, missing, hessians.SOLVED)
    for place, i in enumerate(asked):
        on = np.flatnonzero(free[i])
        block = matrices[i % 2] + np.diag(made.blocks.slopes[i])
        if kind == "coupled":
            block = block + made.coupling[i]
        exact, border = np.zeros(n), np.zeros(n)
        exact[on] = np.linalg.solve(block[np.ix_(on, on)], right[place, on])
        border[on] = np.linalg.solve(block[np.ix_(on, on)], weights[i, on])
        assert out[:, place] == pytest.approx(np.array([exact, 2.0 * exact]), rel=1e-10, abs=1e-11)
        change = (missing[place] + weights[i] @ exact) / (weights[i] @ border)
        assert changes[place] == pytest.approx(change, rel=1e-10)
        assert steps[place] == pytest.approx(change * border - exact, abs=1e-10)
        assert weights[i] @ steps[place] == pytest.approx(missing[place], abs=1e-10)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("control", ["force", "approach"])
def test_responses_are_differences(solver, name, control):
    """To the hundredths that estimates of errors need; nobody gains or loses contact."""
    wear, load = wear_of(name), load_of(control)
    change = 1e-9 * RNG.uniform(0.5, 1.0, (B, N))
    before = solver.solve(GAP, **load, wear=wear)
    response = solver.derivatives.response(change)
    after = solver.solve(GAP + change, **load, wear=wear)
    same_set = ((before.pressure > 0.0) == (after.pressure > 0.0)).all(axis=1)
    assert np.count_nonzero(same_set) > B // 2
    found = (after.pressure - before.pressure)[same_set]
    size = np.abs(found).max(axis=1, keepdims=True)
    size += 1e-9 * before.pressure[same_set].max(axis=1, keepdims=True)
    assert (np.abs(found - response[same_set]) <= 0.05 * size).all()
