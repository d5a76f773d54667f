"""README and the pages of the site: links, options and examples lead to what there is.

``scripts/docs.sh`` builds the site, warnings being errors, and follows the links of what it built.
"""

import doctest
import inspect
import re
from contextlib import suppress

import pytest
from paths import ROOT

import ringwear_par as rw
from ringwear_par.cases.units import in_signs
from ringwear_par.cli import main
from ringwear_par.wear.laws import LAWS

PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "slurm/README.md")),
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "howto").glob("*.md")),
]


def anchors(text):
    """Return what MyST and GitHub call the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w -]", "", line.lower()).replace(" ", "-") for line in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_to_files_of_the_repository_lead_there(page):
    text = page.read_text("utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"\w+:", target) or "generated/" in target:  # by the build
            continue
        name, _, fragment = target.partition("#")
        path = page.parent / name if name else page
        assert path.exists(), target
        assert not fragment or fragment in anchors(path.read_text("utf-8")), target
    for name in re.findall(r"\b(?:scripts|slurm)/[\w/.]+\w", text):
        assert (ROOT / name).exists(), name


def test_every_option_of_every_command_is_on_the_page_of_commands(capsys):
    text = (ROOT / "docs" / "commands.md").read_text("utf-8")
    names = set(re.findall(r"`ringwear (\w+)", text))
    assert {"run", "sweep", "fit", "measure", "verify"} <= names
    for name in names:
        rows = "\n".join(line for line in text.splitlines() if f"`ringwear {name}" in line)
        with suppress(SystemExit):
            main([name, "--help"])
        options = set(re.findall(r"--[a-z][a-z-]*", capsys.readouterr().out))
        assert {o for o in options if o not in rows} <= {"--help", "--output"}, name


@pytest.mark.parametrize("law", LAWS)
def test_every_parameter_of_a_law_is_on_the_page_of_laws_with_its_unit(law):
    text = (ROOT / "docs" / "laws.md").read_text("utf-8")
    section = text.partition(f"\n## {law}\n")[2].partition("\n## ")[0]
    units = dict(re.findall(r"\{key\}`(\w+) <\S+>` \| (.*?) ?\|", section))
    parameters = LAWS[law].parameters.items()
    assert units == {name: in_signs(one.unit).replace("-", "") for name, one in parameters}


EXAMPLES = [name for name in rw.__all__ if ">>>" in (inspect.getdoc(getattr(rw, name)) or "")]


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_of_docstrings_run(name, tmp_path, monkeypatch, capsys):
    (tmp_path / "scripts").symlink_to(ROOT / "scripts")
    monkeypatch.chdir(tmp_path)
    doctest.run_docstring_examples(getattr(rw, name), {}, name=name)
    assert not capsys.readouterr().out
