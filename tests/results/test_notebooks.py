"""Notebooks: figures are pictures, without matplotlib's windows; outcomes tell what they are."""

import base64

import nbformat
import pytest
from commands import SHELL_ENVIRONMENT
from nbclient import NotebookClient
from paths import CASES, PAPER, ROOT

from ringwear_par.results.execution.run import run_case

pytestmark = pytest.mark.serial


def test_a_notebook_shows_figures_and_outcomes(tmp_path, comm):
    run_case(PAPER, tmp_path / "run.h5", ["mesh.contact_elements=8", "time.steps=2"], comm=comm)
    cells = [
        "import ringwear_par as rw",
        "rw.plot('run.h5')",
        "import sys\n'matplotlib.pyplot' in sys.modules",
        "rw.open_result('run.h5')",
        f"rw.read_study({str(CASES / 'study.toml')!r})",
        f"measured = rw.measure({str(ROOT / 'scripts/measure/measure.toml')!r}); measured",
        "measured.report('measured.html')",
    ]
    book = nbformat.v4.new_notebook(cells=[*map(nbformat.v4.new_code_cell, cells)])
    client = NotebookClient(book, timeout=120, resources={"metadata": {"path": str(tmp_path)}})
    client.execute(env=SHELL_ENVIRONMENT)
    (picture,) = book.cells[1].outputs
    assert base64.b64decode(picture.data["image/png"]).startswith(b"\x89PNG")
    assert picture.metadata["image/png"] == {"width": 720, "height": 330}
    assert book.cells[2].outputs[0].data["text/plain"] == "False"
    result, study, measured = (book.cells[n].outputs[0].data["text/html"] for n in (3, 4, 5))
    for html in (result, measured):
        assert html.count('<img src="data:image/png;base64,') == 1
    assert "\npenetration  0.1466 \N{MICRO SIGN}m" in result
    assert "torque  " in result
    assert '<abbr title="threshold pressure' in study
    assert "<td>0, 20, 40</td><td>MPa</td>" in study
    assert study.count("<svg") == 1
    assert "specific wear rate" in measured
    assert book.cells[6].outputs[0].data["text/plain"].startswith("'measured.html: ")
    assert "specific wear rate" in (tmp_path / "measured.html").read_text("utf-8")
