"""The worked sweep: three numbers on the life, against the steady state of the wear law."""

import numpy as np
import pytest
import sweep_wear_law as script


def test_life_is_interpolated_and_nan_where_not_reached():
    time = np.array([[0.0, 1.0, 2.0], [0.0, 1.0, np.nan]])
    depth = script.DEPTH * np.array([[0.0, 0.5, 1.5], [0.0, 0.5, np.nan]])
    assert script.lives(time, depth) == pytest.approx([1.5, np.nan], nan_ok=True)


def test_numbers_are_near_those_of_steady_state(comm, tmp_path):
    numbers = script.study(tmp_path / "wear_law", comm)
    assert numbers.keys() == script.NUMBERS.keys()
    steady = {name: entry[0] for name, entry in script.NUMBERS.items()}
    # running in adds 1.06 um to the penetration by the time of one life at 80 MPa and 1.23 um by
    # that of two: 0.17 um of the remaining 8.8 um are 2 % of the 40 MPa, always upwards
    assert 0 < numbers["doubling_threshold"] - steady["doubling_threshold"] < 1.0
    # k and time enter by their product only: what is left is the time step, 13 of which make a life
    # at the largest k and 210 at the smallest
    assert numbers["similarity"] == pytest.approx(steady["similarity"], abs=5e-3)
    # running in adds in proportion to the load, 0.3 um more at 100 MPa than at 80, or 3.5 % of the
    # remaining depth, if both had run in as long: always upwards
    assert 1.0 < numbers["load_sensitivity"] / steady["load_sensitivity"] < 1.035
    assert (tmp_path / "wear_law/life.png").stat().st_size > 10_000
