"""Posteriors in pieces: none where they would be too many, or of no use."""

from types import SimpleNamespace

import numpy as np
import pytest

from ringwear_par.identification.scatter import pieces as room
from ringwear_par.identification.scatter.pieces import posterior_in_pieces

pytestmark = pytest.mark.serial
MATERIAL = SimpleNamespace(wear=SimpleNamespace(shares=()), converged=True)


@pytest.fixture
def pieces(monkeypatch):
    """Make posteriors about points of a line, of which some may be, and some do not settle."""

    def pieces(shared=1, possible=range(-3, 4), unsettled=()):
        def at(numbers):
            moved = {number: 1.0 if number in unsettled else 0.0 for (number,) in numbers}
            return {
                (n,): SimpleNamespace(log_mass=-0.5 * n**2, moved=moved[n], posterior=n)
                for (n,) in numbers
            }

        made = SimpleNamespace(
            shared=[*range(shared)], at=at,
            first=lambda: [(n,) for n in possible if abs(n) < 3],
            may_be=lambda number: number[0] in possible,
        )  # fmt: skip
        monkeypatch.setattr(room, "_Pieces", lambda misfit, material: made)
        return posterior_in_pieces(None, MATERIAL)

    return pieces


def test_pieces_weigh_what_their_masses_do_up_to_the_improbable(pieces):
    weights = {piece.posterior: piece.weight for piece in pieces(possible=range(-9, 10))}
    assert sorted(weights) == [*range(-4, 5)]  # n^2 / 2 < 7, and their neighbours
    assert sum(weights.values()) == pytest.approx(1.0)
    assert weights[2] / weights[0] == pytest.approx(np.exp(-2.0))


def test_there_are_none_where_no_point_is_within_bounds(pieces):
    """As far outside of a bound as the linear mean may be."""
    assert pieces(possible=()) == ()


def test_there_are_none_along_three_keys(pieces):
    assert pieces(shared=2)
    assert pieces(shared=3) == ()


def test_there_are_none_where_one_that_weighs_does_not_settle(pieces):
    assert pieces(unsettled=[2]) == ()
    assert len(pieces(possible=range(-9, 10), unsettled=[4])) == 9  # nobody notices
