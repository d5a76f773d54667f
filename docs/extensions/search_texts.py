"""Texts of all pages for the excerpts of the search.

Sphinx fetches each page that it has found, which browsers refuse for files; here one script has
all texts, so that a site without a server shows excerpts too.
"""

import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from docutils.nodes import document
    from sphinx.application import Sphinx

_SCRIPT = """"use strict";
const TEXTS = %s;
window.fetch = async (page) => ({ text: async () => page.replace(/^\\.\\//, "") });
Search.htmlToText = (page, anchor) => TEXTS[page]?.[anchor] ?? TEXTS[page]?.[""] ?? "";
"""


def texts(page: "document") -> dict[str, str]:
    """Return the text of a page, under "", and of its sections and terms, under their anchors."""
    from docutils.nodes import comment, raw, section, term

    for aside in [*page.findall(comment), *page.findall(raw)]:
        aside.parent.remove(aside)
    found = {"": page.astext()}
    for part in page.findall(section):
        found |= {f"#{identity}": part.astext() for identity in part["ids"]}
    for part in page.findall(term):
        found |= {f"#{identity}": part.parent.astext() for identity in part["ids"]}
    return {anchor: " ".join(text.split()) for anchor, text in found.items()}


def write(app: "Sphinx", error: Exception | None) -> None:
    """Write the script."""
    if error is not None or app.builder.format != "html":
        return
    pages = {
        app.builder.get_target_uri(name): texts(app.env.get_doctree(name))
        for name in sorted(app.env.found_docs)
    }
    script = _SCRIPT % json.dumps(pages, ensure_ascii=False)
    Path(app.outdir, "_static", "search_texts.js").write_text(script, "utf-8")


def setup(app: "Sphinx") -> dict[str, bool]:
    """Register it."""
    app.connect("build-finished", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
