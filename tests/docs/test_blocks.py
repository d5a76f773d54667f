"""Code blocks of README and of the pages run, those of a page in order and in one folder.

Commands run in this process, but for those under ``mpirun`` or with options of PETSc. A block of
TOML is read as what its tables are: a fit, a measurement, a study, a plan, or a case, which what is
missing is taken from the paper's. A comment before a block says what is special about it:

- ``<!-- file: NAME -->``: the block is kept under this name, as its text says
- ``<!-- not run: why -->``
"""

import ast
import functools
import importlib.util
import os
import re
import shlex
import shutil
import tomllib
from pathlib import Path

import pytest
from commands import python
from parts import main, read_fit, read_measure
from paths import ROOT

import ringwear_par as rw

pytestmark = pytest.mark.slow

BLOCK = re.compile(
    r"(?:^<!-- (?P<word>file|not run): (?P<said>[^\n]+?) -->\n\n?)?"
    r"^```(?P<language>python|bash|toml|text)\n(?P<code>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md")), *sorted((DOCS / "howto").glob("*.md"))]
PAGES = [page for page in PAGES if BLOCK.search(page.read_text("utf-8"))]
PAGES.remove(DOCS / "howto/optimisers.md")  # which tests/functions/test_optimisers.py runs
#: what needs a network, a cluster or a set-up, waits for somebody, or is tested as a whole
LEFT_OUT = r"(bash|pip|source|ssh|srun|PETSC_DIR=\S+|ringwear explore|ringwear verify)(?!\S)"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the examples, where a user of the pages stands."""
    for name in ("cases", "fit", "measure"):
        shutil.copytree(ROOT / "scripts" / name, tmp_path / "scripts" / name)
    torque = "".join(f"{time},470\n" for time in range(0, 151, 10))
    record = tmp_path / "scripts/fit/test1_torque.csv"
    record.write_text(f"time_s,torque_Nm\n{torque}", "utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@functools.cache
def fitted(*words):
    """Run a fit of the repository's files once for all pages; return its folder."""
    assert main([*words]) == 0
    return Path(words[-1]).absolute()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_blocks_run(page, folder):
    text, names = page.read_text("utf-8"), {}
    for block in BLOCK.finditer(text):
        word, said, language, code = block.group("word", "said", "language", "code")
        if word == "file":
            Path(said).write_text(code, "utf-8")
        elif word == "not run" or language == "text":
            continue
        elif language == "bash":
            run_commands(code)
        elif language == "python":
            run_python(code, names, f"{page.name}, line {text[: block.start()].count(chr(10))}")
        else:
            read_tables(code, folder / "scripts")


def run_commands(code):
    """Run the commands of a block, which must all end well."""
    for line in filter(None, map(str.strip, code.splitlines())):
        words = shlex.split(line, comments=True)
        if re.match(LEFT_OUT, line):
            continue
        if words[0] == "cd":
            os.chdir(words[1])
            continue
        if words[0] == "mpirun":
            done = python("-m", "ringwear_par", *words[4:], ranks=int(words[2]))
        elif "--" in words:  # options of PETSc stay in a process
            done = python("-m", "ringwear_par", *words[1:])
        else:
            assert words[0] == "ringwear", line
            if words[1:3] == ["fit", "scripts/fit/repeats.toml"]:
                if (done := fitted(*words[1:])) != Path(words[-1]).absolute():
                    shutil.copytree(done, words[-1])
            else:
                assert main(words[1:]) == 0, line
            continue
        assert done.returncode == 0, f"{line}\n{done.stderr}"


def run_python(code, names, where):
    """Run a block of Python, unless it imports what is not installed."""
    for node in ast.walk(ast.parse(code)):
        modules = [one.name for one in node.names] if isinstance(node, ast.Import) else []
        modules += [node.module] if isinstance(node, ast.ImportFrom) else []
        if any(importlib.util.find_spec(name.partition(".")[0]) is None for name in modules):
            return
    exec(compile(code, where, "exec"), names)


def read_tables(code, scripts):
    """Read a block of TOML as the commands read it."""
    tables = tomllib.loads(code)
    kinds = {"fit": "fit", "experiment": "fit", "compare": "fit", "measure": "measure"}
    kind = next((kinds[name] for name in kinds if name in tables), "cases")
    file = scripts / kind / "block.toml"
    if kind == "fit":  # a table of an experiment is of the last one of the fit before it
        before = "" if "fit" in tables else (scripts / "fit/whole.toml").read_text("utf-8")
        file = scripts / "fit/whole.toml"
        file.write_text(f"{before}\n{code}", "utf-8")
        read_fit(file)
    elif "design" in tables and "vary" not in tables:
        plan = tomllib.loads((scripts / "fit/plan.toml").read_text("utf-8"))
        read_fit({**plan, **tables, "case": str(scripts / "cases/paper.toml")}, plans=True)
    else:
        file.write_text(code, "utf-8")
        if kind == "measure":
            read_measure(file)
        elif "vary" in tables:
            rw.read_study(file)
        else:
            rw.read_case(completed(tables, scripts / "cases"))


def completed(tables, cases):
    """Return a whole case that has the tables of a block, each as it is."""
    base = tomllib.loads((cases / "paper.toml").read_text("utf-8"))
    case = {**base, **tables}
    for ring in {"lower", "upper"} & tables.keys():
        case[ring] = {**base[ring], **tables[ring]}
    if "upper" in tables and "lower" not in tables:  # which it must meet
        case["lower"] = {**base["lower"], "r": [0.0, 40.0], "z": [0.0, tables["upper"]["z"][0]]}
    if law := tables.get("wear", {}).get("lower", {}).get("file"):
        case["wear"]["lower"]["file"] = str(cases / law)
    return case
