"""Numbers on pages that are measured when the site is built, written to ``docs/generated``.

The checks of ``ringwear verify``, all of them and those of the default mesh, and the summary of the
page of the first case.
"""

import contextlib
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from case_words import first_case_of, write
from mpi4py import MPI

import ringwear_par as rw
from ringwear_par.elasticity.bem.assembly import load_kernels
from ringwear_par.verification.check import Check, Kind
from ringwear_par.verification.verify import checks

if TYPE_CHECKING:
    from sphinx.application import Sphinx

_MESH = "paper, 50 MPa: "
_KINDS: dict[Kind, tuple[str, str]] = {
    "reference": (
        "Reference solutions",
        "Errors against closed forms, finite elements and stored solutions on fine meshes.",
    ),
    "identity": (
        "Identities",
        "Balances and symmetries. They hold to round-off, on held faces to the mesh error.",
    ),
    "bound": ("Bounds", "Numbers that must not exceed a limit."),
}


def mesh_table(found: Sequence[Check]) -> str:
    """Return the errors of the unworn paper's rings on several meshes, in Markdown."""
    named = {one.name.removeprefix(_MESH): one for one in found if one.name.startswith(_MESH)}
    columns = [("approach",), ("p(30)",), ("p(28.6)", "p(31.4)")]
    lines = [
        f"| contact elements | {' | '.join(', '.join(names) for names in columns)} |",
        "|---|---|---|---|",
    ]
    for row, size in enumerate(named["approach"].sizes):
        errors = (max(named[name].errors[row] for name in names) for names in columns)
        lines.append(f"| {size} | {' | '.join(f'{error:.1e}' for error in errors)} |")
    return "\n".join(lines) + "\n"


def check_page(found: Sequence[Check]) -> str:
    """Return the page of all checks, in Markdown."""
    lines = [
        "# Every check", "",
        f"What `ringwear verify` of version {rw.__version__} measured when this site was built: "
        "errors on the finest mesh of each check, relative where no unit is named, and their "
        "observed order, where meshes are compared and the reference is accurate enough.", "",
    ]  # fmt: skip
    for kind, (heading, meaning) in _KINDS.items():
        lines += [f"## {heading}", "", meaning, ""]
        lines += ["| compared | elements | error | allowed | order |", "|---|---|---|---|---|"]
        for one in found:
            if one.kind == kind:
                order = "" if one.order is None else f"{one.order:.1f}"
                cells = (one.name.replace("<", r"\<"), str(one.sizes[-1]), f"{one.errors[-1]:.1e}",
                         f"{one.tolerance:.0e}", order)  # fmt: skip
                lines.append(f"| {' | '.join(cells)} |")
        lines.append("")
    return "\n".join(lines)


def first_summary(text: str) -> str:
    """Return what the case of the page of the first case ends with."""
    return rw.simulate(first_case_of(text)).summary() + "\n"


def _made(app: "Sphinx") -> None:
    folder = Path(app.srcdir) / "generated"
    folder.mkdir(exist_ok=True)
    page = (Path(app.srcdir) / "first_case.md").read_text("utf-8")
    write(folder / "first_case.txt", first_summary(page))
    load_kernels(MPI.COMM_SELF)
    with contextlib.redirect_stdout(io.StringIO()):
        found = list(checks(MPI.COMM_SELF))
    write(folder / "mesh_errors.md", mesh_table(found))
    write(folder / "verify.md", check_page(found))


def setup(app: "Sphinx") -> dict[str, bool]:
    """Measure before Sphinx looks for pages."""
    app.connect("builder-inited", _made)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
