"""The summary of the page of the first case, computed when the site is built."""

from pathlib import Path
from typing import TYPE_CHECKING

from case_words import first_case_of, write

import ringwear_par as rw

if TYPE_CHECKING:
    from sphinx.application import Sphinx


def first_summary(text: str) -> str:
    """Return what the case of the page of the first case ends with."""
    return rw.simulate(first_case_of(text)).summary() + "\n"


def _made(app: "Sphinx") -> None:
    folder = Path(app.srcdir) / "generated"
    folder.mkdir(exist_ok=True)
    page = (Path(app.srcdir) / "first_case.md").read_text("utf-8")
    write(folder / "first_case.txt", first_summary(page))


def setup(app: "Sphinx") -> dict[str, bool]:
    """Measure before Sphinx looks for pages."""
    app.connect("builder-inited", _made)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
