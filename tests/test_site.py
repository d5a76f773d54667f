"""The site and README: what they say can be typed, and every law, key and command is told.

``scripts/docs.sh`` builds the site, warnings being errors, and follows the links of what it built.
"""

import re
import shlex
from pathlib import Path

import case_words
import check_links
import pytest

import ringwear_par as rw
from ringwear_par.cases import schema
from ringwear_par.cases.keys import flatten
from ringwear_par.cases.schema import BY_PATH, TABLES
from ringwear_par.cli import _parser
from ringwear_par.identification import schema as fit_schema
from ringwear_par.textfiles import parse_toml
from ringwear_par.wear.catalogue import LAWS
from ringwear_par.wear.parameters import parameters_of

ROOT = Path(__file__).parents[1]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "howto").glob("*.md")),
]

pytestmark = pytest.mark.serial


def each_page(holds):
    """Run a test for each page that holds what it looks at."""
    pages = [page for page in PAGES if holds in page.read_text("utf-8")]
    assert len(pages) > 1
    return pytest.mark.parametrize("page", pages, ids=lambda page: page.name)


def blocks(page, language):
    """Return the code blocks of a page in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text("utf-8"), re.M | re.S)


def commands(page):
    """Return the words of every ringwear command on a page, without what starts it."""
    for block in blocks(page, "bash"):
        for line in block.splitlines():
            words = shlex.split(line, comments=True)
            if "ringwear" in words and words[0] in ("ringwear", "mpirun", "srun"):
                yield words[words.index("ringwear") + 1 :]


def anchors(text):
    """Return what MyST and GitHub call the headings of a page."""
    return {re.sub(r"[^\w -]", "", h.lower()).replace(" ", "-") for h in
            re.findall(r"^#+ (.*)$", text, re.M)}  # fmt: skip


@each_page("](")
def test_links_to_files_of_the_repository_lead_there(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text("utf-8")):
        if re.match(r"\w+:", target):
            continue
        name, _, fragment = target.partition("#")
        path = page.parent / name if name else page
        if "generated" in path.parts:  # by the build, of scripts in docs/gallery or of the code
            script = ROOT / "docs" / "gallery" / f"{path.stem}.py"
            assert script.exists() or path.stem in ("index", "first_case", "verify"), target
            continue
        assert path.exists(), target
        assert not fragment or fragment in anchors(path.read_text("utf-8")), target


@each_page("\nringwear ")
def test_commands_are_ones_that_can_be_given(page):
    for words in commands(page):
        cut = words.index("--") if "--" in words else len(words)
        try:
            _parser().parse_args(words[:cut])
        except SystemExit:
            pytest.fail(" ".join(words))
        for word in words:
            if word.startswith("scripts/"):
                assert (ROOT / word).exists(), word


@each_page("```python")
def test_python_has_names_that_there_are(page):
    for block in blocks(page, "python"):
        compile(block, str(page), "exec")
        assert set(re.findall(r"\brw\.(\w+)", block)) <= set(rw.__all__)


@each_page("```toml")
def test_toml_has_keys_that_there_are(page):
    for block in blocks(page, "toml"):
        tables = parse_toml(block, page.name)
        if {"vary", "fit", "experiment", "design"} & tables.keys():
            continue
        keys = flatten(tables, page.name)
        assert keys
        for key in keys:
            assert key in BY_PATH or any(
                path in BY_PATH and path not in TABLES for path in _above(key)
            ), key
        if {"lower", "upper", "time"} <= tables.keys():
            rw.read_case(tables)


def _above(key):
    """Return the keys whose tables a dotted key may be in."""
    words = key.split(".")
    return [".".join(words[:n]) for n in range(1, len(words))]


def test_every_command_and_option_is_told():
    text = (ROOT / "docs" / "commands.md").read_text("utf-8")
    parser = _parser()
    (actions,) = (action for action in parser._actions if action.dest == "command")
    for name, command in actions.choices.items():
        rows = "\n".join(line for line in text.splitlines() if f"`ringwear {name}" in line)
        assert rows, name
        for action in command._actions:
            for option in action.option_strings:
                if option.startswith("--") and option not in ("--help", "--output"):
                    assert re.search(rf"{option}\b", rows), f"{name} {option}"


@pytest.mark.parametrize(
    ("name", "keys"), [("case_keys", schema.KEYS), ("fit_keys", fit_schema.KEYS)]
)
def test_every_key_has_its_entry(name, keys):
    page = case_words.key_page(name)
    entries = re.findall(r"^```\{(?:case|fit)key\} (\S+)\n(.*?)^```", page, re.M | re.S)
    assert [path for path, _ in entries] == [key.path for key in keys]
    for key, (_, entry) in zip(keys, entries, strict=True):
        assert case_words._plain(key.allowed) in entry
        assert ("it must be given" in entry) == (key.default is ...)


@pytest.mark.parametrize("name", LAWS)
def test_every_law_has_its_page_and_its_curve(name):
    page = case_words.law_page(name)
    for parameter in parameters_of(LAWS[name]).values():
        assert re.search(rf"`{parameter.name} <wear\.\w+\.{parameter.name}>`", page)
        assert parameter.unit == "-" or parameter.unit in page
    (axes,) = case_words.law_figure(name).axes
    for line in axes.lines:
        rate = line.get_ydata()
        if line.get_label().startswith("V"):
            assert rate[0] == 0.0
            assert rate[-1] > 0.0


def test_a_law_that_no_case_shows_is_an_error(monkeypatch, tmp_path):
    monkeypatch.setattr(case_words, "CASES", tmp_path)
    with pytest.raises(LookupError, match="wear law archard: no case"):
        case_words.law_page("archard")


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("k p V", "k p V"),
        ("k mu max(0, p - p0) V", r"k \mu  \max ( 0 , p - p_0 ) V"),
        ("linear between points of p V", None),
    ],
)
def test_formulas_in_symbols_are_set_as_such(formula, expected):
    assert case_words.latex(formula) == expected


def test_links_that_lead_nowhere_are_found(tmp_path):
    (tmp_path / "a.html").write_text('<p id="here"><a href="b.html#there">', "utf-8")
    (tmp_path / "b.html").write_text(
        '<a href="a.html#here"><a href="#no"><img src="c.png">', "utf-8"
    )
    assert check_links.broken(tmp_path) == [
        "a.html: b.html#there leads nowhere",
        "b.html: #no leads nowhere",
        "b.html: c.png leads nowhere",
    ]
