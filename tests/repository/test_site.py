"""The site and README: what they say can be typed, and every law, key and command is told.

``scripts/docs.sh`` builds the site, warnings being errors, and follows the links of what it built.
"""

import ast
import doctest
import inspect
import re
import shlex
import shutil

import case_words
import check_links
import measured
import pytest
from paths import ROOT

import ringwear_par as rw
from ringwear_par.cases import schema
from ringwear_par.commands import parser
from ringwear_par.files.text import parse_toml
from ringwear_par.identification.definition import schema as fit_schema
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.test_design.candidates import count_of
from ringwear_par.measuring.definition import schema as measure_schema
from ringwear_par.measuring.definition.measure_file import read_measure
from ringwear_par.studies.definition import schema as study_schema
from ringwear_par.wear.law import parameters_of
from ringwear_par.wear.laws import LAWS

PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "howto").glob("*.md")),
]

#: made by the build of other things than scripts in docs/gallery
GENERATED = ("index", "first_case", "rig", *case_words.STANDARD_CASES)

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
            stem = re.sub("^sphx_glr_|_001$", "", path.stem)  # of the script, also of its picture
            assert (ROOT / f"docs/gallery/{stem}.py").exists() or stem in GENERATED, target
            continue
        assert path.exists(), target
        assert not fragment or fragment in anchors(path.read_text("utf-8")), target


@each_page("\nringwear ")
def test_commands_are_ones_that_can_be_given(page):
    for words in commands(page):
        cut = words.index("--") if "--" in words else len(words)
        try:
            parser().parse_args(words[:cut])
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


@pytest.fixture
def examples(tmp_path, monkeypatch):
    """A copy of the examples' folders, their cases being the folder that one is in."""
    for name in ("cases", "fit", "measure"):
        shutil.copytree(ROOT / "scripts" / name, tmp_path / name)
    first = (ROOT / "docs" / "first_case.md").read_text("utf-8")
    (tmp_path / "fit" / "rig.toml").write_text(measured.first_case_of(first).text, "utf-8")
    torque = "".join(f"{time},470\n" for time in range(0, 151, 10))
    (tmp_path / "fit" / "test1_torque.csv").write_text(f"time_s,torque_Nm\n{torque}", "utf-8")
    rows = ["test,pressure / MPa,duration / s,record"]
    for name, depth in (("A", 0.1), ("B", 0.2)):
        rows.append(f"{name},80,2,{name}.csv")
        (tmp_path / "fit" / f"{name}.csv").write_text(
            f"time_s,penetration_um\n1,{depth}\n2,{depth}\n"
        )
    (tmp_path / "fit" / "tests.csv").write_text("\n".join(rows) + "\n")
    monkeypatch.chdir(tmp_path / "cases")
    return tmp_path


@each_page("```toml")
def test_toml_is_read_as_the_program_reads_it(page, examples):
    whole_fit = ""
    for number, block in enumerate(blocks(page, "toml")):
        tables = parse_toml(block, page.name)
        if {"fit", "experiment", "compare"} & tables.keys():
            file = examples / "fit" / f"block_{number}.toml"
            # a table of an experiment is of the last one of the fit before it
            whole_fit = block if "fit" in tables else f"{whole_fit}\n{block}"
            file.write_text(whole_fit, "utf-8")
            read_fit(file)
        elif {"measure", "test"} & tables.keys():
            file = examples / "measure" / f"block_{number}.toml"
            file.write_text(block, "utf-8")
            read_measure(file)
        elif "vary" in tables:
            file = examples / "cases" / f"block_{number}.toml"
            file.write_text(block, "utf-8")
            rw.read_study(file)
        elif "design" in tables:
            plan = parse_toml((examples / "fit" / "plan.toml").read_text("utf-8"), "plan.toml")
            whole = {**plan, **tables, "case": "paper.toml"}
            assert count_of(read_fit(whole, plans=True).design) > 1
        else:
            rw.read_case(_completed(tables))


def _completed(tables):
    """Return a whole case that has the tables of a block, each as it is."""
    base = parse_toml((ROOT / "scripts/cases/paper.toml").read_text("utf-8"), "paper.toml")
    case = {**base, **tables}
    for ring in {"lower", "upper"} & tables.keys():
        case[ring] = {**base[ring], **tables[ring]}
    if "upper" in tables and "lower" not in tables:  # which it must meet
        case["lower"] = {**base["lower"], "r": [0.0, 40.0], "z": [0.0, tables["upper"]["z"][0]]}
    if "wear" in tables:
        case["wear"] = tables["wear"]
    return case


def test_every_command_and_option_is_told():
    text = (ROOT / "docs" / "commands.md").read_text("utf-8")
    (actions,) = (action for action in parser()._actions if action.dest == "command")
    for name, command in actions.choices.items():
        rows = "\n".join(line for line in text.splitlines() if f"`ringwear {name}" in line)
        assert rows, name
        for action in command._actions:
            for option in action.option_strings:
                if option.startswith("--") and option not in ("--help", "--output"):
                    assert re.search(rf"{option}\b", rows), f"{name} {option}"


@pytest.mark.parametrize(
    ("name", "keys"),
    [
        ("case_keys", schema.KEYS),
        ("study_keys", study_schema.KEYS),
        ("fit_keys", fit_schema.KEYS),
        ("measure_keys", measure_schema.KEYS),
    ],
)
def test_every_key_has_its_entry(name, keys):
    page = case_words.key_page(name)
    rows = dict(re.findall(r"^\* - ```\{\w+key\} (\S+)\n(.*?)(?=^\*|^````)", page, re.M | re.S))
    assert sorted(rows) == sorted(key.path for key in keys)
    for key in keys:
        assert case_words._plain(key.allowed) in rows[key.path]
        assert ("- required\n" in rows[key.path]) == (key.default is ...)


@pytest.mark.parametrize("name", LAWS)
def test_every_law_has_its_page_and_its_curve(name):
    page = case_words.law_page(name)
    first, told = re.match(rf"# {name}\n\n([^\n]*\.)\n\n(.*)## Parameters", page, re.S).groups()
    assert f"| [`{name}`](generated/laws/{name}.md) | {first} |" in case_words.law_list()
    assert "\nUse it " in told  # and what it is in, and what it does not do
    assert re.search(r"mm/s|1/MPa", told)
    assert re.search(r"\bnot?\b|at least|only", told.partition("\nUse it ")[2].partition("\n\n")[2])
    for parameter in parameters_of(LAWS[name]).values():
        assert re.search(rf"`{parameter.name} <wear\.\w+\.{parameter.name}>`", page)
        assert parameter.unit == "-" or parameter.unit in page
    (axes,) = case_words.law_figure(name).axes
    for line in axes.lines:
        rate = line.get_ydata()
        if line.get_label().startswith("V"):
            assert rate[0] == 0.0
            assert rate[-1] > 0.0


def test_the_first_case_is_explained_line_by_line():
    page = (ROOT / "docs" / "first_case.md").read_text("utf-8")
    told = page.partition("Line by line:")[2].partition("\n## ")[0]
    assert len(re.findall(r"^\d+\. ", told, re.M)) == len(measured.first_summary(page).splitlines())


FUNCTIONS = [name for name in rw.__all__ if inspect.isfunction(getattr(rw, name))]


def test_docstrings_of_public_functions_say_what_they_return():
    docs = {name: inspect.getdoc(getattr(rw, name)) for name in FUNCTIONS}
    assert [name for name in docs if "\nReturns\n-------\n" not in docs[name]] == ["save"]


@pytest.mark.parametrize(
    "name", [name for name in FUNCTIONS if ">>>" in (getattr(rw, name).__doc__ or "")]
)
def test_examples_of_docstrings_run(name, tmp_path, monkeypatch):
    (tmp_path / "scripts").symlink_to(ROOT / "scripts")
    monkeypatch.chdir(tmp_path)
    (example,) = doctest.DocTestFinder(recurse=False).find(getattr(rw, name), name, globs={})
    said = []
    doctest.DocTestRunner().run(example, out=said.append)
    assert not said, "".join(said)


def texts_of_the_program():
    """Yield all texts of the package's modules, with … for what is put into them."""
    for module in (ROOT / "ringwear_par").rglob("*.py"):
        for node in ast.walk(ast.parse(module.read_text("utf-8"))):
            if isinstance(node, ast.JoinedStr):
                parts = (getattr(part, "value", "") for part in node.values)
                yield "".join(part if isinstance(part, str) else "…" for part in parts)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield re.sub("%[ds]", "…", node.value)


def test_messages_that_are_explained_are_ones_of_the_program():
    page = (ROOT / "docs" / "messages.md").read_text("utf-8")
    headings, texts = re.findall("^### (.*)$", page, re.M), [*texts_of_the_program()]
    assert len(headings) > 15
    assert not [one for one in headings if not any(one in text for text in texts)]


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


def test_links_that_lead_nowhere_and_pictures_without_a_text_are_found(tmp_path):
    (tmp_path / "a.html").write_text('<p id="here"><a href="b.html#there">', "utf-8")
    (tmp_path / "b.html").write_text(
        '<a href="a.html#here"><a href="#no"><img src="c.png">'
        '<img src="a.html" alt="a picture of pages">', "utf-8"
    )  # fmt: skip
    assert check_links.broken(tmp_path) == [
        "a.html: b.html#there leads nowhere",
        "b.html: #no leads nowhere",
        "b.html: c.png has no text of three words or more",
        "b.html: c.png leads nowhere",
    ]
