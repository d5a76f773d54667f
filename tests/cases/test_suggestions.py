"""What is suggested for a key that there is not: its last part counts before its table."""

import pytest

from ringwear_par.cases.files import key_values
from ringwear_par.cases.files.key_values import nearest_key, unknown_key
from ringwear_par.cases.schema import KEYS


@pytest.mark.parametrize(
    ("path", "near"),
    [
        ("wear.lower.K", "wear.lower.k"),
        ("lower.nu", "lower.poisson"),
        ("lower.E", "lower.young"),
        ("upper.Youngs_modulus", "upper.young"),
        ("load.rpm", "load.omega"),
        ("rpm", "load.omega"),
        ("load.normal_force", "load.force"),
        ("time.dt", "time.step"),
        ("mesh.elements", "mesh.contact_elements"),
        ("wear.lower.coefficient", "wear.lower.k"),
        ("lowr.young", "lower.young"),
        ("wear.lower.q0", "wear.lower.p0"),
        ("lower.k", "wear.lower.k"),
        ("contact.pressure", "load.pressure"),
        ("young", "lower.young or upper.young"),
        ("lower.layers.0.thickness", "lower.layers[0].thickness"),
        ("lower.layers[-1].thickness", "lower.layers[0].thickness"),
        ("upper.layer[1].E", "upper.layers[1].young"),
        ("lower.layers[2].E", "young"),
        ("stress.grid.N", "stress.grid.n"),
        ("stress.body", "stress.grid.body"),
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


def test_other_names_are_of_keys():
    last = {key.path.rpartition(".")[2] for key in KEYS}
    meant = {name for names in key_values._ALIASES.values() for name in names}
    assert meant <= last
    assert not key_values._ALIASES.keys() & (last - {"n"})
