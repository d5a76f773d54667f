"""The table of a fit file's keys is that of what is read, and the files there are have no other."""

import copy
import json
import re
from pathlib import Path

import pytest
from laboratory import refused

from ringwear_par.cases.tables import key_table
from ringwear_par.cli import main
from ringwear_par.errors import InputError
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.schema import KEYS

FIT = Path(__file__).parents[3] / "scripts/fit"
PARAMETER = {"start": 1e-7, "bounds": [1e-9, 1e-5]}
SERIES = {"quantity": "penetration", "unit": "um", "sd": 0.1, "times": [1.0, 2.0]}
PROFILE = {"quantity": "profile.lower", "unit": "um", "sd": 0.1, "r": [29.0, 30.0, 31.0]}
SOUGHT = {"wear.lower.k": PARAMETER}
MASS = {"quantity": "mass.lower", "unit": "g", "sd": 0.1, "density": 0.001}
FILE = {"quantity": "penetration", "sd": 0.1, "file": str(FIT / "test1_penetration.csv"),
        "columns": {"time": "time_s", "value": "penetration_um"}}  # fmt: skip
VALUE = {"quantity": "approach", "sd": 0.1, "value": 1.0, "unit": "um"}
TABLES = {
    "case": str(FIT.parent / "cases/paper.toml"),
    "fit": {"parameters": SOUGHT},
    "experiment": [
        {"name": "one", "set": {}, "data": [SERIES, PROFILE, MASS, FILE, VALUE]},
    ],
    "compare": {"a": {"set": {"wear.lower.p0": 1.0}, "parameters": SOUGHT}},
    "design": {"vary": {"load.pressure": [1.0, 2.0]}, "budget": {}},
}


def keys_of(path, tables):
    """Return the keys that a table may have, as the fault of an unknown one tells them."""
    tables = json.loads(json.dumps(tables))  # no table in two places
    place = tables
    for key in path:
        place = place[key]
    place["unheard of"] = {}
    (fault,) = (f for f in refused(tables, plans=True) if "unheard of: unknown key" in f)
    return set(fault.rpartition("must be one of ")[2].split(", "))


def in_schema(table):
    """Return the keys of a table that the schema has."""
    paths = [key.path.removeprefix(table) for key in KEYS if key.path.startswith(table)]
    return {
        re.sub(
            r"^(parameters|process|units|scatter|data|input|scale|vary|budget|nuisance|sd)\..*",
            r"\1",
            p,
        )
        for p in paths
    }


@pytest.mark.parametrize(
    ("path", "table"),
    [
        (("fit",), "fit."),
        (("fit", "parameters", "wear.lower.k"), "fit.parameters.KEY."),
        (("experiment", 0), "experiment."),
        (("compare", "a"), "compare.NAME."),
        (("design",), "design."),
        (("design", "vary"), "design.vary."),
        (("design", "budget"), "design.budget."),
    ],
)
def test_every_key_is_told(path, table):
    assert keys_of(path, TABLES) == in_schema(table)


def test_every_key_of_an_input_is_told():
    speed = {"key": "load.omega", "scale": {}, "file": FILE["file"], "columns": FILE["columns"]}
    tables = {**TABLES, "experiment": [{**TABLES["experiment"][0], "input": [speed]}]}
    place = "experiment", 0, "input", 0
    assert keys_of(place, tables) == in_schema("experiment.input.")
    assert keys_of((*place, "scale"), tables) == in_schema("experiment.input.scale.")


def test_every_key_of_readings_is_told():
    data = range(len(TABLES["experiment"][0]["data"]))
    found = [keys_of(("experiment", 0, "data", i), TABLES) for i in data]
    assert set.union(*found) == in_schema("experiment.data.")
    errors = set()
    for i in (0, 1):
        tables = copy.deepcopy(TABLES)
        tables["experiment"][0]["data"][i]["nuisance"] = {"unheard of": {}}
        (fault,) = (f for f in refused(tables, plans=True) if "unheard of" in f)
        errors |= set(fault.rpartition("must be one of ")[2].split(", "))
    table = "experiment.data.nuisance."
    told = {key.path.removeprefix(table) for key in KEYS if key.path.startswith(table)}
    of_growth = {
        "amplitude",
        "power",
        "time",
        *(f"time.{name}" for name in ("start", "prior", "bounds")),
    }
    of_growth = {f"thermal.{name}" for name in of_growth}
    assert told == errors | {"KIND.prior", "KIND.bounds"} | of_growth


def test_top_tables_are_told():
    with pytest.raises(InputError, match="Case: unknown key") as caught:
        read_fit(TABLES | {"Case": 1}, plans=True)
    told = set(caught.value.faults[0].rpartition("must be one of ")[2].split(", "))
    assert told == {key.path.partition(".")[0] for key in KEYS}


def test_defaults_are_those_of_what_is_read():
    """A file that says every default is read as one that says none."""
    tables = copy.deepcopy(TABLES)
    for key in KEYS:
        table, _, name = key.path.rpartition(".")
        if table in ("fit", "design") and key.default is not None:
            tables[table][name] = key.default
    tables["fit"]["parameters"]["wear.lower.k"]["scale"] = "linear"
    plain, said = (read_fit(each, plans=True) for each in (TABLES, tables))
    assert said.settings == plain.settings
    assert said.design == plain.design
    assert said.parameters == plain.parameters


@pytest.mark.serial
def test_the_table_is_printed(capsys):
    assert main(["info", "--schema", "fit"]) == 0
    fit = capsys.readouterr().out
    assert fit == f"{key_table(KEYS)}\n"
    assert re.search(r"^experiment.data.density +g/mm\^3 ", fit, re.MULTILINE)
    assert main(["info", "--schema"]) == 0
    said = capsys.readouterr().out
    assert said.index("wear.lower.k") < said.index("vary.KEY.log") < said.index("fit.starts")
    assert said.endswith(fit)
    for words in (["study", "sobol"], ["Sobol"]):
        assert main(["info", "--schema", *words]) == 0
        said = capsys.readouterr().out
        assert "design.method" in said
        assert ("fit.starts" in said) == (len(words) == 1)
        assert "contact.friction" not in said
    assert main(["info", "--schema", "case", "sobol"]) == 2
    assert "sobol: is in no row of the keys of case files" in capsys.readouterr().err
