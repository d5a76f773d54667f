"""What is made of the code when the site is built: pages of keys, and pictures of wear laws.

They are written to ``docs/generated``. Roles ``key``, ``studykey``, ``fitkey`` and ``measurekey``
link to a key's entry.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import ringwear_par as rw
from ringwear_par.cases.law import Law
from ringwear_par.cases.schema import KEYS as CASE_KEYS
from ringwear_par.cases.units import in_signs
from ringwear_par.files.text import parse_toml, toml_value
from ringwear_par.identification.definition.schema import KEYS as FIT_KEYS
from ringwear_par.measuring.definition.schema import KEYS as MEASURE_KEYS
from ringwear_par.pictures.style import COLOURS, DASHES, STYLE
from ringwear_par.schedules import value
from ringwear_par.studies.variations import KEYS as STUDY_KEYS
from ringwear_par.wear.at import LocalState
from ringwear_par.wear.laws import LAWS

if TYPE_CHECKING:
    from sphinx.application import Sphinx

CASES = Path(__file__).parents[2] / "scripts" / "cases"
#: of the page of standard tests, which shows their rigs
STANDARD_CASES = ("astm_d3702", "jis_k7218_a", "face_seal")
#: what is told on the page of a kind of file: directive of its entries, title, keys
KEYS: Mapping[str, tuple[str, str, Sequence[Any]]] = {
    "case_keys": ("casekey", "Keys of a case file", CASE_KEYS),
    "study_keys": ("studykey", "Keys of a study file", STUDY_KEYS),
    "fit_keys": ("fitkey", "Keys of a fit file", FIT_KEYS),
    "measure_keys": ("measurekey", "Keys of a measure file", MEASURE_KEYS),
}
#: steps in the picture of the first case
FIRST_STEPS = "0,1,3,5"
#: depths worn (mm) at which laws that remember them are drawn
_WORN = (0.0, 0.003, 0.01)


def _curves(case: "rw.Case", law: Law) -> Figure:
    """Return the figure of a law's rate against pressure, as in a case."""
    r = 0.5 * sum(case.contact)
    p = np.linspace(0.0, 160.0, 321)
    full = float(value(case.load.omega, 0.0, np.array([r]))) * r
    worn = _WORN if law.remembers else (0.0,)
    styles = iter(zip(COLOURS, DASHES, strict=True))
    with rc_context(STYLE):
        figure = Figure(figsize=(4.6, 3.0), layout="constrained")
        axes = figure.add_subplot()
        for speed, depth in [(full, d) for d in worn] + [(0.5 * full, 0.0)]:
            ones = np.ones_like(p)
            at = LocalState(0.0, r * ones, speed * ones, case.friction, depth * ones, 0.0 * ones)
            label = f"V = {speed:.0f} mm/s"
            if len(worn) > 1:
                label += f", {1e3 * depth:g} \N{MICRO SIGN}m worn"
            colour, dashes = next(styles)
            axes.plot(p, 3.6e6 * law.rate(p, at), color=colour, linestyle=dashes, label=label)
        axes.set_xlim(0.0, p[-1])
        axes.set_ylim(bottom=0.0)
        averaged = "averaged contact" if law.length else "contact"
        axes.set_xlabel(f"{averaged} pressure (MPa)")
        axes.set_ylabel("rate of wear (\N{MICRO SIGN}m/h)")
        axes.legend(frameon=False)
    return figure


def law_figure(name: str) -> Figure:
    """Return the picture of a law, as lower wears in the case that the page of laws shows."""
    stem = {"threshold": "paper", "user": "user_law"}.get(name, name.replace("-", "_"))
    case = rw.read_case(CASES / f"{stem}.toml")
    law = case.laws_by_table["wear.lower"]
    assert law is not None
    return _curves(case, law)


def _default(usual: Any) -> str:
    return "none" if usual is None else f"`{toml_value(usual)}`"


def key_page(name: str) -> str:
    """Return a page of keys, in MyST: a table for each table of the file."""
    directive, title, keys = KEYS[name]
    tables: dict[str, list[Any]] = {}
    for key in keys:
        tables.setdefault(".".join(key.path.split(".")[:-1][:2]), []).append(key)
    names = {table: f"`[{table}]`" if table else "At the top" for table in tables}
    links = (f"[{title}](#{re.sub(r'[^a-z-]', '', title.lower().replace(' ', '-'))})"
             for title in names.values())  # fmt: skip
    lines = ["---", "hide-toc: true", "---", f"# {title}", "", " ".join(links), ""]
    for table, rows in tables.items():
        lines += [f"## {names[table]}", "", "````{list-table}", ":header-rows: 1", ":class: keys"]
        lines += ["", "* - key", "  - unit", "  - default", "  - allowed", "  - meaning"]
        for key in rows:
            unit = "" if key.unit in ("-", "1") else _plain(in_signs(key.unit))
            usual = "required" if key.default is ... else _default(key.default)
            lines += [f"* - ```{{{directive}}} {key.path}", "    ```"]
            lines += [f"  - {cell}" for cell in (unit, usual, _plain(key.allowed),
                                                 _plain(key.meaning))]  # fmt: skip
        lines += ["````", ""]
    return "\n".join(lines)


def _plain(text: str) -> str:
    """Return plain text as MyST takes it."""
    return re.sub(r"([\[\]{}<>*_])", r"\\\1", text)


def first_case_of(text: str) -> "rw.Case":
    """Return the case of the page of the first case, which is its first TOML block."""
    block = text.partition("```toml\n")[2].partition("```")[0]
    return rw.read_case(parse_toml(block, "first_case.md"))


def first_case(text: str) -> Figure:
    """Return the picture of the page of the first case, as its last command draws it."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "rig.h5"
        rw.simulate(first_case_of(text)).save(path)
        return rw.plot(path, "wear,pressure", FIRST_STEPS)


def write(path: Path, text: str) -> None:
    """Write a page that has changed; Sphinx would read the others again."""
    if not path.exists() or path.read_text("utf-8") != text:
        path.write_text(text, "utf-8")


def _made(app: "Sphinx") -> None:
    folder = Path(app.srcdir) / "generated"
    (folder / "laws").mkdir(parents=True, exist_ok=True)
    for name in LAWS:
        law_figure(name).savefig(folder / "laws" / f"{name}.svg", metadata={"Date": None})
    page = (Path(app.srcdir) / "first_case.md").read_text("utf-8")
    first_case(page).savefig(folder / "first_case.png", dpi=200)
    rw.plot(first_case_of(page)).savefig(folder / "rig.svg")
    for name in STANDARD_CASES:
        rw.plot(rw.read_case(CASES / f"{name}.toml")).savefig(folder / f"{name}.svg")
    for name in KEYS:
        write(folder / f"{name}.md", key_page(name))


def _signed(env: Any, path: str, node: Any) -> str:
    """Set a key as an entry's name, which may be broken behind its dots."""
    from docutils.nodes import raw
    from sphinx.addnodes import desc_name

    for part in re.findall(r"[^.]+\.?", path):
        node += [desc_name(part, part), raw("", "<wbr>", format="html")]
    return path


def setup(app: "Sphinx") -> dict[str, bool]:
    """Make the pages before Sphinx looks for any."""
    for kind, role in (("case", "key"), ("study", "studykey"), ("fit", "fitkey"),
                       ("measure", "measurekey")):  # fmt: skip
        app.add_object_type(f"{kind}key", role, parse_node=_signed, objname=f"{kind} key")
    app.connect("builder-inited", _made)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
