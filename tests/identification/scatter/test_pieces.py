"""Posteriors in pieces: none where they would be too many, or of no use."""

from types import SimpleNamespace

import numpy as np
import pytest

from ringwear_par.identification.scatter import pieces as room
from ringwear_par.identification.scatter.pieces import posterior_in_pieces

MATERIAL = SimpleNamespace(wear=SimpleNamespace(shares=()), converged=True)


@pytest.fixture
def pieces(monkeypatch):
    """Make posteriors about points of a line, of which some may be, and some do not settle.

    Some have no histories.
    """

    def pieces(shared=1, possible=range(-3, 4), unsettled=(), lost=()):
        def at(numbers):
            return {
                (n,): SimpleNamespace(
                    log_mass=-0.5 * n**2, moved=float(n in unsettled), posterior=n,
                    has_histories=n not in lost, test_unknowns=None,
                )
                for (n,) in numbers
            }  # fmt: skip

        made = SimpleNamespace(
            shared=[*range(shared)], at=at,
            first=lambda: [(n,) for n in possible if abs(n) < 3],
            may_be=lambda number: number[0] in possible,
        )  # fmt: skip
        monkeypatch.setattr(room, "_Pieces", lambda misfit, material: made)
        return posterior_in_pieces(None, MATERIAL)

    return pieces


def test_pieces_weigh_what_their_masses_do_up_to_the_improbable(pieces):
    weights = {piece.posterior: piece.weight for piece in pieces(possible=range(-9, 10))[0]}
    assert sorted(weights) == [*range(-4, 5)]  # n^2 / 2 < 7, and their neighbours
    assert sum(weights.values()) == pytest.approx(1.0)
    assert weights[2] / weights[0] == pytest.approx(np.exp(-2.0))


def test_there_are_none_where_no_point_is_within_bounds(pieces):
    """As far outside of a bound as the linear mean may be."""
    assert pieces(possible=()) == ((), "")


def test_there_are_none_along_three_keys(pieces):
    assert pieces(shared=2)[0]
    assert pieces(shared=3) == ((), "")


def test_there_are_none_where_one_that_weighs_does_not_settle(pieces):
    none, doubt = pieces(unsettled=[2])
    assert none == ()
    assert doubt.endswith("tests do not settle for 5.4 % of what is known")
    others, doubt = pieces(possible=range(-9, 10), unsettled=[4])
    assert (len(others), doubt) == (9, "")  # nobody notices


def test_pieces_without_histories_are_left_out_and_told(pieces):
    found, doubt = pieces(lost=[-2])
    assert [piece.posterior for piece in found] == [-1, 0, 1, 2, 3]
    assert sum(piece.weight for piece in found) == pytest.approx(1.0)
    assert doubt.endswith("leave out 5.4 % of what is known: there are no histories")
    none, doubt = pieces(lost=[*range(-3, 4)])
    assert none == ()
    assert doubt.endswith("there are no histories for 1e+02 % of what is known")
