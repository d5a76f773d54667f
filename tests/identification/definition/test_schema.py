"""The table of a fit file's keys is that of what is read, and the files there are have no other."""

import copy
import re
from pathlib import Path

from parts import main

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


def test_the_table_is_printed(capsys):
    assert main(["info", "--schema", "fit"]) == 0
    fit = capsys.readouterr().out
    assert re.search(r"^experiment.data.density +g/mm\^3 ", fit, re.MULTILINE)
    assert main(["info", "--schema", "sobol"]) == 0
    output = capsys.readouterr().out
    assert "design.method" in output
    assert "contact.friction" not in output
    assert main(["info", "--schema", "case", "sobol"]) == 2
