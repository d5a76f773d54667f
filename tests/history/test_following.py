"""Histories whose elements follow the wear: against a fixed mesh, restarts, ranks, balances."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from parts import Load, Mesh, Ring, Stepping, TaoContact, ThresholdLaw
from paths import PAPER
from reference_cases import paper_case, round_face
from tracing import ALONE, first_contact, trace

import ringwear_par as rw
from ringwear_par.history.block import Block
from ringwear_par.history.following import Following
from ringwear_par.history.refusals import check_mesh
from ringwear_par.history.schemes import start

UPDATED = Mesh(24, geometry="updated", geometry_tolerance=0.003)


@pytest.mark.parametrize("scheme", [Stepping("implicit", 4.0, 50), Stepping("adaptive", until=200)])
def test_following_changes_little_and_keeps_the_balances(scheme):
    case = paper_case(UPDATED, p0=(0.0, 0.0), k=(1e-7, 2e-8), stepping=scheme)
    history = trace(case)
    fixed = trace(replace(case, mesh=replace(UPDATED, geometry="fixed")), tao=True)
    assert history.following.updates >= 4
    last, moved = history.last, history.states
    assert history.balances.force <= 1e-9
    assert history.balances.residual <= 1e-7
    assert history.balances.energy <= 1e-12
    difference = last.approach - fixed.last.approach
    assert 1e-6 < abs(difference) < 1e-4  # mm, of 20 um of wear
    inner = slice(5, -5)
    ratio = (last.pressure / fixed.last.pressure)[inner]
    assert np.abs(ratio - 1.0).max() < 1e-3
    for before, after in itertools.pairwise(moved):  # about the tolerance behind
        assert np.abs(before.wear - after.meshed).max() <= 0.003
        assert (
            np.abs(after.wear - after.meshed).max()
            <= 0.003 + np.abs(after.wear - before.wear).max()
        )


def test_tolerance_tends_to_zero():
    case = paper_case(UPDATED, p0=(0.0, None), stepping=Stepping("implicit", 5.0, 40))
    approach = {}
    for tolerance in (0.008, 0.004, 0.0002):
        mesh = replace(UPDATED, geometry_tolerance=tolerance)
        approach[tolerance] = trace(replace(case, mesh=mesh)).last.approach
    errors = [abs(approach[t] - approach[0.0002]) for t in (0.008, 0.004)]
    assert errors[1] < 0.75 * errors[0]


@pytest.mark.parametrize("geometry", ["fixed", "updated"])
@pytest.mark.parametrize("shape", ["sphere", "torus"])
def test_worn_volume_while_the_contact_grows(shape, geometry):
    """And what is worn off is what the disc would cut from the sphere or torus, but for elasticity.

    The indenter wears, the disc does not; they are stiff, so that the worn face is nearly flat.
    """
    r = (0.0, 3.0) if shape == "sphere" else (18.0, 22.0)
    face = round_face(r, 40.0)
    mesh = Mesh(48, grading=1.0, geometry=geometry, geometry_tolerance=0.0005)
    case = paper_case(mesh, stepping=Stepping("adaptive", until=400.0))
    case = replace(
        case,
        lower=Ring((0.0, 30.0), (0.0, 20.0), 2e6, 0.3, "clamped"),
        upper=Ring(r, (20.0, 30.0), 2e6, 0.3, "clamped", face),
        wear_lower=None, wear_upper=ThresholdLaw(2e-6),
        load=Load(1.0, 300.0),
    )  # fmt: skip
    history = trace(case, tao=True)
    touching = [int((s.pressure > 0).sum()) for s in history.states]
    assert touching[-1] > touching[0] + 3
    assert all(b >= a for a, b in itertools.pairwise(touching))
    last = history.last
    assert history.balances.energy <= 1e-10
    assert history.balances.force <= 1e-10
    line = history.line
    # the cut that has the same volume: how deep is it, and does it reach as far as the contact?
    depth = np.interp(line.r, *zip(*face, strict=True))
    levels = np.linspace(-0.1, 0.0, 4001)
    cut = np.maximum(depth - levels[:, None], 0.0) @ line.area
    deepest = -float(np.interp(line.area @ last.wear[1], cut[::-1], levels[::-1]))
    assert last.wear[1].max() == pytest.approx(deepest, rel=0.15)
    if geometry == "updated":
        assert history.following.updates >= 1


def test_bodies_that_interpenetrate_too_much():
    """A load that presses by more explains it; one that does not is refused."""
    case = paper_case(Mesh(16))
    pressed = first_contact(case).approach
    for overlap, fine in ((0.5 * pressed, True), (1.5 * pressed, False)):
        lower = replace(case.lower, z=(0.0, 20.0 + overlap))
        one = replace(case, lower=lower, time=Stepping("implicit", 1.0, 1))
        if fine:
            approach = trace(one).states[0].approach
            # a lower ring a little higher
            assert approach == pytest.approx(0.5 * pressed, rel=5e-3)
        else:
            with pytest.raises(rw.InputError, match=r"0\.087\d+ mm at element 0"):
                trace(one)


def test_contact_that_reaches_an_open_end_is_an_error():
    mesh = Mesh(16, contact=(29.0, 31.5))
    with pytest.raises(rw.ComputationError, match=r"mesh\.contact at r = 29 mm"):
        trace(replace(paper_case(mesh), time=Stepping("implicit", 1.0, 1)))


def test_places_that_stand_out_are_an_error_with_the_place():
    """As where a layer hardly wears and what is under it does."""
    wear = np.zeros((2, 24))
    wear[0] = 8.0
    wear[0, ::2] = 0.01
    case = paper_case(UPDATED, p0=(0.0, None), stepping=Stepping("implicit", 5.0, 40))
    following = Following(case, ALONE)
    block = Block.of([case], [following.pair])
    with TaoContact(block.compliance, True) as solver:
        state = replace(start(block, solver)[0], wear=wear[:1, None])
        told = r"lower is worn by 8 mm at r = .* and by 0\.01 mm at r = .* beside it"
        with pytest.raises(rw.ComputationError, match=told):
            following.follow(block, solver, state)


def test_a_hole_that_drowns_in_round_off_is_refused():
    case = rw.read_case(PAPER, {"lower.r": [1e-15, 40.0]})
    with pytest.raises(rw.InputError, match=r"lower\.r\[0\] is .* 4\.0e-10 mm"):
        check_mesh(case, "a.toml")
