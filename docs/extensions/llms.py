"""``llms.txt``: all pages of the site with a sentence on each, for language models."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx
    from sphinx.environment import BuildEnvironment

#: what holds the paragraphs that say what a page, or a name of Python, is
_WHERE = ("section", "desc_content")


def in_order(env: "BuildEnvironment", page: str) -> Iterator[str]:
    """Yield a page and all below it, in the order of the tables of contents."""
    yield page
    for below in env.toctree_includes.get(page, ()):
        yield from in_order(env, below)


def first_sentence(env: "BuildEnvironment", page: str) -> str:
    """Return the first sentence of a page, "" where it has none."""
    from docutils.nodes import paragraph

    paragraphs = env.get_doctree(page).findall(paragraph)
    # not those of notes, tables and lists
    text = next((p.astext() for p in paragraphs if p.parent.tagname in _WHERE), "")
    return re.split(r"(?<=[a-z0-9)][.?])\s", " ".join(text.split()))[0]


def write(app: "Sphinx", error: Exception | None) -> None:
    """Write the list beside the pages."""
    if error is not None or app.builder.format != "html":
        return
    env, root = app.env, app.config.root_doc
    lines = [f"# {app.config.project}", "", f"> {first_sentence(env, root)}", ""]
    for page in dict.fromkeys(in_order(env, root)):
        title, address = env.titles[page].astext(), app.builder.get_target_uri(page)
        lines.append(f"- [{title}]({address}): {first_sentence(env, page)}")
    Path(app.outdir, "llms.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def setup(app: "Sphinx") -> dict[str, bool]:
    """Register it."""
    app.connect("build-finished", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
