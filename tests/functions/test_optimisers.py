"""The examples of the page on optimisers run, and find what closed forms or the case say."""

import re

import numpy as np
import pytest
from paths import PAPER, ROOT

import ringwear_par as rw

PAGE = (ROOT / "docs" / "howto" / "optimisers.md").read_text("utf-8")
#: of the examples: enough for what is looked at here
SMALL = {"time.scheme": "adaptive", "mesh.contact_elements": 12}


def run(package, monkeypatch):
    """Run the first block of the page and that of a package; return the names."""
    pytest.importorskip(package.lower().replace("-", ""))
    case = rw.read_case(PAPER, SMALL)
    monkeypatch.setattr(rw, "read_case", lambda path, overrides: case)
    names = {"__name__": package}
    blocks = re.findall(r"^(?:## ([^\n]*)\n.*?)?^```python\n(.*?)^```", PAGE, re.M | re.S)
    for heading, block in blocks:
        if not heading or heading.endswith(package):
            exec(compile(block, f"{package} on the page", "exec"), names)
    return names


def test_scipy(monkeypatch):
    names = run("SciPy", monkeypatch)
    best = names["best"]
    assert best.success
    assert np.abs(best.fun).max() < 1e-9
    assert best.nfev < 12


def test_emcee(monkeypatch):
    names = run("emcee", monkeypatch)
    chain = names["sampler"].get_chain(discard=8, flat=True)
    values = names["f"]({"wear.lower.k": 1e-7 * chain[:, 0], "load.pressure": chain[:, 1]})
    assert np.mean(chain[:, 1]) == pytest.approx(80.0, abs=1.5)
    assert np.std(chain[:, 1]) == pytest.approx(2.0, rel=0.5)
    assert np.mean(values["penetration"]) == pytest.approx(9.7e-3, abs=1e-4)
    assert np.std(values["penetration"]) == pytest.approx(2e-4, rel=0.5)


def test_libensemble(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # for its log
    history = run("libEnsemble", monkeypatch)["history"]
    done = history[history["sim_ended"]]
    assert len(done) == 16
    assert (done["penetration"] > 0.0).all()


@pytest.mark.parametrize("package", ["Xopt", "Optimas", "QUEENS", "UM-Bridge"])
def test_others(package, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    run(package, monkeypatch)
