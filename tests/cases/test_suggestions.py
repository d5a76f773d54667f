"""What is suggested for a key that there is not: its last part counts before its table."""

import pytest

from ringwear_par.cases.files.key_values import nearest_key, unknown_key


@pytest.mark.parametrize(
    ("path", "near"),
    [
        ("wear.lower.K", "wear.lower.k"),
        ("lower.nu", "lower.poisson"),
        ("lower.E", "lower.young"),
        ("load.rpm", "load.omega"),
        ("load.normal_force", "load.force"),
        ("time.dt", "time.step"),
        ("wear.lower.coefficient", "wear.lower.k"),
        ("lowr.young", "lower.young"),
        ("contact.pressure", "load.pressure"),
        ("young", "lower.young or upper.young"),
        ("lower.layers.0.thickness", "lower.layers[0].thickness"),
        ("lower.layers[-1].thickness", "lower.layers[0].thickness"),
        ("lower.layers[2].E", "young"),
        ("stress.grid.N", "stress.grid.n"),
    ],
)
def test_near_keys(path, near):
    assert nearest_key(path) == f" (did you mean {near}?)"


@pytest.mark.parametrize("path", ["lower.material", "wear.lower.q", "oops.x", "lower.colour", "a"])
def test_nothing_is_near(path):
    assert nearest_key(path) == ""


@pytest.mark.parametrize(
    ("path", "told"),
    [
        ("contact.oil", "must be friction"),
        ("stress.colour", "must be points, times, exclude, grid"),
        ("lower.layers[0].colour", "must be thickness, young, poisson, density, wear"),
        (
            "lower.layers[0].wear.q",
            "must be law, k, p0, m, n, table, k_start, depth, distance",
        ),
    ],
)
def test_where_none_is_near_those_of_the_table_are_told(path, told):
    assert unknown_key(path) == f"unknown key; {told}"
    assert unknown_key("oops.x") == "unknown key"
