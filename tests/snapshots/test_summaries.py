"""What commands print, word by word, in ``summaries.txt``; SNAPSHOTS=write writes it anew."""

import os
import re
import shutil
from pathlib import Path

import pytest
from parts import main
from paths import ROOT

pytestmark = pytest.mark.slow
STORED = Path(__file__).with_name("summaries.txt")
SMALL = "mesh.contact_elements=16"
COMMANDS = [
    f"run cases/paper.toml -o run.h5 --set {SMALL}",
    f"run cases/two_layers.toml -o layers.h5 --set {SMALL} stress.times=last "
    "stress.exclude=0.05 lower.layers[0].density=7.8e-3",
    f"run cases/paper.toml -o crude.h5 --set {SMALL} time.scheme=explicit time.step=60 "
    "time.steps=3",
    "sweep cases/wear_law.toml -o sweep",
    "fit fit/tests.toml -o dry --dry-run",
    "fit fit/tests.toml -o fit.out",
    f"predict fit.out cases/paper.toml -o next --draws 8 --set {SMALL} load.pressure=60",
    "measure measure/measure.toml -o rates",
]
NUMBER = r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?"
#: round-off, and lines of speeds
VARIES = re.compile(r"\d(\.\d+)?e-1\d")
OF_SPEED = re.compile(r"^seconds|computed in|time of the ranks")


def masked(line, drawn):
    """Return a line without the numbers that differ from run to run, or none that are of draws.

    Draws part ways where processors round in other ways.
    """
    if drawn or OF_SPEED.search(line):
        return re.sub(r" {2,}", "  ", re.sub(NUMBER, "#", line))
    return VARIES.sub("#", line)


def test_summaries(tmp_path, monkeypatch, capsys):
    for folder in ("cases", "fit", "measure"):
        shutil.copytree(ROOT / "scripts" / folder, tmp_path / folder)
    monkeypatch.chdir(tmp_path)
    parts = []
    for command in COMMANDS:
        assert main(command.split()) in (0, None), capsys.readouterr().err
        drawn = "fit.out" in command
        lines = [masked(line, drawn) for line in capsys.readouterr().out.splitlines()]
        parts.append("\n".join([f"$ ringwear {command}", *lines]))
    printed = "\n\n".join(parts) + "\n"
    if os.environ.get("SNAPSHOTS") == "write":
        STORED.write_text(printed, encoding="utf-8")
    assert printed == STORED.read_text(encoding="utf-8")
