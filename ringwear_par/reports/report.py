"""``ringwear report``: a page of a run, a sweep, a fit and so on, in one file."""

import re
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import cast

from ringwear_par.errors import ComputationError, InputError, counted
from ringwear_par.files import folders
from ringwear_par.files.writing import atomic_write, check_writable
from ringwear_par.reports.blocks import Page
from ringwear_par.results.files import result_of
from ringwear_par.results.result import Outcome, Result
from ringwear_par.studies.ensemble import RESULTS
from ringwear_par.version import __version__

_ENDINGS = (".html", ".htm")
#: modules, and functions in them, of the pages of folders by what these hold
_PAGES = {
    folders.FIT: "fit_page", folders.DESIGN: "fit_page", folders.MEASURE: "measure_page",
    folders.PREDICTION: "prediction_page", RESULTS: "sweep_page",
}  # fmt: skip
#: where a browser would begin a line within a number
_EXPONENT = re.compile(r"\d[\d.]*e-\d+")
#: cells of tables that stand right
_NUMERIC = re.compile(r"[-+\N{MINUS SIGN}]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?: %)?")


def report(source: Outcome | str | Path, output: str | Path) -> str:
    """Write a page of stored results; return what was written. On one rank.

    It is one HTML file: its figures are drawings in it, and it fetches nothing. Laws that a case
    has in files of the user's are not run.

    Parameters
    ----------
    source : a result or another outcome, the file of a result, or the folder of a sweep, a fit, a
        design, a prediction or a measurement.
    output : the page's file, .html.

    Returns
    -------
    str : the page's name and what it holds.

    Raises
    ------
    InputError : what cannot be read or written, or a package that is missing.
    ComputationError : the disk.

    Examples
    --------
    >>> import ringwear_par as rw
    >>> rw.report(rw.simulate(rw.read_case("scripts/cases/paper.toml")), "run.html")
    'run.html: Wear history of a test, 7 figures'
    """
    output = Path(output)
    check_page(output)
    if isinstance(source, Result | str | Path):
        return write_page(_page(source), output)
    with TemporaryDirectory() as folder:  # pages are made of what is stored
        stored = Path(folder) / output.stem
        source.save(stored)
        return write_page(_page(stored), output)


def write_page(page: Page, output: Path) -> str:
    """Write a page; return what was written. On one rank.

    Raises
    ------
    ComputationError : the disk.
    """
    try:
        with atomic_write(output) as temporary:
            temporary.write_text(html_text(page), encoding="utf-8")
    except OSError as error:
        raise ComputationError(f"{output}: {error.strerror or error}") from error
    return f"{output}: {page.kind}, {counted(page.figures, 'figure')}"


def check_page(output: Path) -> None:
    """Refuse a page that cannot be written.

    Raises
    ------
    InputError : its name or folder, or a package that is missing.
    """
    if output.suffix.lower() not in _ENDINGS:
        raise InputError(f"{output}: its ending must be one of {', '.join(_ENDINGS)}")
    check_writable(output)
    try:
        import jinja2  # noqa: F401
    except ImportError as error:
        raise InputError(
            f"{output}: needs the Python package jinja2; pip install 'ringwear-par[pages]'"
        ) from error


def _page(source: Result | str | Path) -> Page:
    if not isinstance(source, Result) and (fault := _other_file(Path(source))):
        raise InputError(f"{source}: {fault}")
    if isinstance(source, Result) or not Path(source).is_dir():
        from ringwear_par.reports.run_page import run_page

        return run_page(result_of(source))
    folder = Path(source)
    for name, page in _PAGES.items():
        if (folder / name).exists():
            function = getattr(import_module(f"ringwear_par.reports.{page}"), page)
            return cast(Page, function(folder))
    raise InputError(
        f"{folder}: holds none of {folders.FIT}, {folders.DESIGN}, {folders.MEASURE}, "
        f"{folders.PREDICTION} and {RESULTS}; must be a result file, or a folder that ringwear "
        "sweep, fit, design, predict or measure has completed"
    )


def _other_file(path: Path) -> str:
    """Return the fault of a file of another kind, with the command for it; "" of results."""
    if path.suffix == ".toml" and path.is_file():
        kinds = {"[[experiment]]": "a fit file; ringwear fit", "[vary": "a study; ringwear sweep",
                 "[[test]]": "a measure file; ringwear measure"}  # fmt: skip
        text = path.read_text(errors="replace")
        kind = next((k for word, k in kinds.items() if word in text), "a case file; ringwear run")
        return f"is {kind} computes it"
    if path.suffix == ".json" and path.is_file():
        return f"is a file of a folder; ringwear report {path.parent} makes the page of it"
    return ""


def html_text(page: Page) -> str:
    """Return the text of a page; everything that is not of the template is escaped."""
    import jinja2
    from markupsafe import Markup, escape

    parts = files("ringwear_par.reports") / "page"
    surroundings = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    surroundings.tests["numeric"] = lambda cell: _NUMERIC.fullmatch(str(cell)) is not None
    surroundings.filters["unbroken"] = lambda cell: Markup(
        _EXPONENT.sub(r'<span class="number">\g<0></span>', str(escape(cell)))
    )
    template = surroundings.from_string((parts / "page.html").read_text("utf-8"))
    style = Markup((parts / "page.css").read_text("utf-8"))
    return template.render(page=page, version=__version__, style=style)
