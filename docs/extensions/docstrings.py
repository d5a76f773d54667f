"""Docstrings of the package as numpydoc reads them, and links to its public names.

``name : meaning`` of a section, where the signature has the type, would be read as name and type.
"""

import re
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

import ringwear_par as rw

_ARRAY = re.compile(r"~?numpy\.ndarray\[~?typing\.Any, ~?numpy\.dtype\[~?numpy\.\w+\]\]")
_ENTRY = re.compile(r"^([\w.*]+(?:, [\w*]+)*) : (.*)$")


def _reread(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Put the meaning of an entry on lines of its own."""
    told = []
    section = False
    for number, line in enumerate(lines):
        if number + 1 < len(lines) and lines[number + 1].startswith("---"):
            section = line.strip() in ("Parameters", "Returns", "Raises")
        entry = _ENTRY.match(line) if section else None
        told += [entry[1], f"    {entry[2]}"] if entry else [line]
    lines[:] = told


def _signed(
    app: Sphinx, what: str, name: str, thing: Any, options: Any, signature: str, returned: str
) -> tuple[str, str] | None:
    """Leave out how classes are made, which users do not make, and what arrays are arrays of."""
    if what in ("class", "exception"):
        return "", ""
    if not signature:
        return None
    return _ARRAY.sub("~numpy.ndarray", signature), _ARRAY.sub("~numpy.ndarray", returned or "")


def _public(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, child: nodes.Node
) -> nodes.Node | None:
    """Find a name of a room, as annotations have it, or one without module, among the public."""
    name = node.get("reftarget", "").rpartition(".")[2]
    if node.get("refdomain") != "py" or name not in rw.__all__:
        return None
    domain = env.get_domain("py")
    return domain.resolve_xref(
        env, node["refdoc"], app.builder, "obj", f"ringwear_par.{name}", node, child
    )


def setup(app: Sphinx) -> dict[str, bool]:
    """Come before numpydoc, and after Sphinx has looked for a name."""
    app.connect("autodoc-process-docstring", _reread, priority=100)
    app.connect("autodoc-process-signature", _signed)
    app.connect("missing-reference", _public)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
