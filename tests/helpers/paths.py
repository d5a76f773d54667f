"""Folders and files of the repository that tests read."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
CASES = ROOT / "scripts" / "cases"
FIT = ROOT / "scripts" / "fit"
PAPER = CASES / "paper.toml"
HELPERS = Path(__file__).parent
