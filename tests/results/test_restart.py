"""A run that is stopped and gone on with has the bits of one that was not, whatever it computes."""

import pytest
from paths import CASES, PAPER
from stored import assert_same, attributes

from ringwear_par.results.files import open_result
from ringwear_par.results.run import run_case

SMALL = ["mesh.contact_elements=16", "time.steps=20"]
ADAPTIVE = ["mesh.contact_elements=16", "time.scheme=adaptive", "time.end=50"]
MOVING = ["mesh.geometry=updated", "mesh.geometry_tolerance=0.001"]
GRID = 'stress={grid={r=[28.0, 32.0], z=[19.0, 21.0], n=[4, 3]}, times="all"}'
CROWN = ["mesh={contact_elements=24, grading=1.0}", "load.force=500",
         'time={scheme="implicit", step=20, steps=4}']  # fmt: skip
#: by what is special about it: the case, its keys, the step after which it is stopped, and
#: a variable that must be stored and not be zero
RUNS = {
    "first step": (PAPER, SMALL, 1, "pressure"),
    "rows apart": (PAPER, [*SMALL, "output.every=6"], 7, "pressure"),
    "last profiles": (PAPER, [*SMALL, "output.profiles=last"], 19, "pressure"),
    "explicit": (PAPER, [*SMALL, "time.scheme=explicit", "time.step=0.05"], 7, "pressure"),
    "adaptive": (PAPER, [*ADAPTIVE, "output.profiles=last"], 1, "checkpoint/state"),
    "times": (PAPER, [*ADAPTIVE, "output.times=[1, 5, 6.5]"], 6, "checkpoint/state"),
    "coating partly gone": (
        CASES / "wear_through.toml", ["mesh.contact_elements=16", "time.end=90.0"], 16,
        "share_through_lower",
    ),
    "new meshes": (PAPER, [*SMALL, "time.step=4", *MOVING], 9, "pressure"),
    "new meshes, adaptive": (PAPER, [*ADAPTIVE, "time.end=80", *MOVING], 9, "pressure"),
    "boundaries": (
        CASES / "fields.toml",
        ["mesh.contact_elements=16", "output.boundary=all", *MOVING[:1], "wear.lower.k=1e-6",
         "mesh.geometry_tolerance=0.004"], 5, "boundary/upper/displacement",
    ),
    "stresses": (PAPER, [*SMALL, "time.steps=6", "time.step=30", GRID], 3, "mises_grid"),
    "stresses, new meshes": (
        PAPER, [*SMALL, "time.steps=6", "time.step=30", GRID, *MOVING], 3, "mises_grid",
    ),
    "doubts of before": (CASES / "crown.toml", CROWN, 3, "pressure"),
}  # fmt: skip


@pytest.mark.parametrize("name", RUNS)
def test_restart_equals_an_uninterrupted_run(name, restarted, comm):
    path, keys, step, variable = RUNS[name]
    whole, parts = restarted(path, keys, step, f"SIGTERM after step {step}")
    assert assert_same(whole, parts)[variable].any()
    one, other = open_result(whole), open_result(parts)
    assert (one.doubts, one.balances) == (other.doubts, other.balances)
    assert one.doubts or name != "doubts of before"
    for attribute in ("time_through_lower", "assemblies", "updates"):
        assert one.attributes.get(attribute) == other.attributes.get(attribute)


@pytest.mark.parametrize("keys", [SMALL, [*SMALL[:1], *MOVING, "time.step=4"]])
def test_a_longer_run_has_all_numbers_and_counts(keys, tmp_path, comm):
    whole, parts = tmp_path / "whole.h5", tmp_path / "parts.h5"
    for path, steps in ((whole, 20), (parts, 9), (parts, 20)):
        run_case(PAPER, path, [*keys, f"time.steps={steps}"], comm=comm, restart=steps == 20)
    assert_same(whole, parts)
    assert attributes(whole) == attributes(parts)
