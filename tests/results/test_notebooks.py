"""Figures in a notebook: seen as pictures, without matplotlib's windows."""

import base64

import nbformat
import pytest
from commands import SHELL_ENVIRONMENT
from nbclient import NotebookClient
from paths import PAPER

from ringwear_par.results.execution.run import run_case

pytestmark = pytest.mark.serial


def test_a_notebook_shows_figures(tmp_path, comm):
    run_case(PAPER, tmp_path / "run.h5", ["mesh.contact_elements=8", "time.steps=2"], comm=comm)
    cells = [
        "import ringwear_par as rw",
        "rw.plot('run.h5')",
        "import sys\n'matplotlib.pyplot' in sys.modules",
    ]
    book = nbformat.v4.new_notebook(cells=[*map(nbformat.v4.new_code_cell, cells)])
    client = NotebookClient(book, timeout=120, resources={"metadata": {"path": str(tmp_path)}})
    client.execute(env=SHELL_ENVIRONMENT)
    (picture,) = book.cells[1].outputs
    assert base64.b64decode(picture.data["image/png"]).startswith(b"\x89PNG")
    assert picture.metadata["image/png"] == {"width": 720, "height": 330}
    assert book.cells[2].outputs[0].data["text/plain"] == "False"
