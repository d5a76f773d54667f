"""Pages of a run, a sweep and a fit: what they say, and that they fetch nothing."""

import json
import re
import shutil

import numpy as np
import pytest
from laboratory import fit_tables, write_tests
from paths import PAPER
from report_pages import Read

import ringwear_par as rw

pytestmark = pytest.mark.slow

#: units of figures and pages
MICRO, CUBED = "\N{MICRO SIGN}m", "mm\N{SUPERSCRIPT THREE}"
SCRIPT = "<script>alert(1)</script>"
CASE = {
    "title": SCRIPT, "lower.density": 7.8e-3, "wear.upper": {"law": "archard", "k": 2e-8},
    "mesh.contact_elements": 12, "time.steps": 8,
}  # fmt: skip
KINDS = ("run", "sweep", "fit")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run, a sweep and a fit, with their pages."""
    folder = tmp_path_factory.mktemp("reported")
    rw.simulate(rw.read_case(PAPER, CASE)).save(folder / "run.h5")
    (folder / "paper.toml").write_text(rw.read_case(PAPER, {**CASE, "time.steps": 3}).text)
    study = {
        "case": str(folder / "paper.toml"),
        "vary": {
            "wear.lower.k": {"log": [1e-8, 1e-6], "count": 5},
            # the last of which cannot be
            "load.pressure": {"values": ["5e4 kPa", "1e5 kPa", "1e12 kPa"]},
            "upper.grip": {"values": ["clamped", "platen"]},
        },
    }
    with pytest.raises(rw.ComputationError, match="10 of 30 cases failed"):
        rw.sweep(rw.read_study(study), folder / "sweep")
    experiments = write_tests(folder)
    for experiment in experiments:
        experiment["name"] += SCRIPT
    one = {"quantity": "mass.lower", "value": 2.0, "unit": "mg", "sd": 1.0, "density": 1.9e-3}
    experiments[0]["data"].append({**one, "at": 100.0})
    tables = fit_tables(folder, experiments)
    law = {"set": {"wear.lower.law": "archard"}}
    law["parameters"] = {"wear.lower.k": tables["fit"]["parameters"]["wear.lower.k"]}
    rw.fit({**tables, "compare": {"archard": law}}, compare=True).save(folder / "fit")
    for kind, source in zip(KINDS, ("run.h5", "sweep", "fit"), strict=True):
        rw.report(folder / source, folder / f"{kind}.html")
    return folder


@pytest.fixture(scope="module")
def pages(folder):
    return {kind: Read((folder / f"{kind}.html").read_text()) for kind in KINDS}


def test_the_page_of_a_run_has_the_numbers_of_its_summary(folder, pages):
    result, page = rw.open_result(folder / "run.h5"), pages["run"]
    rows, numbers = page.rows("quantity"), result.to_dict()["numbers"]
    shown = [row[0] for row in rows.values()]
    for name in ("penetration", "lower_specific_rate", "largest_pressure", "torque"):
        assert f"{numbers[name]['value']:.4g}" in shown, name
    assert any("upper.density not given" in name for name in rows)
    force = next(row for name, row in page.rows("check").items() if "contact force" in name)
    assert force[0] == f"{result.balances['force']:.1e}"


def test_a_wrong_balance_has_not_passed(folder, tmp_path):
    result = rw.open_result(folder / "run.h5")
    result.attributes["balance_residual"] = 0.1
    rw.report(result, tmp_path / "page.html")
    assert re.search(r"checks\s*1 wrong", Read((tmp_path / "page.html").read_text()).text)


def test_the_page_of_a_run_draws_what_changes(folder, pages):
    """And says what does not, which would be a level line."""
    drawings = pages["run"].drawings
    for words in ("worn depth (µm)", "penetration depth", "worn volume", "friction"):
        assert any(words in texts for texts in drawings.values()), words
    rig = next(texts for alt, texts in drawings.items() if "Section of the rig" in alt)
    assert "mean pressure 80 MPa" in rig
    assert "Constant, see the key numbers: axial force" in pages["run"].text
    assert " ".join(rw.open_result(folder / "run.h5").case.split()) in pages["run"].text


def test_the_page_of_a_sweep_has_its_failures(folder, pages):
    page = pages["sweep"]
    with rw.open_ensemble(folder / "sweep") as ensemble:
        ids, status = ensemble["case"].values, ensemble["status"].values
        final = ensemble["final_penetration"].values
    assert "10 of 30 cases failed" in page.text
    table = next(table for table in page.tables if "status" in table[0])
    rows = {row[0]: row[1:] for row in table[1:]}
    assert set(rows) == set(ids)
    assert [row[1] for row in table[1:11]] == ["failed"] * 10
    assert table[0][3:6] == ["mean pressure (MPa)", "grip, upper", f"penetration ({MICRO})"]
    assert {row[2] for row in rows.values()} == {"50", "100", "1e+09"}
    for case, state, depth in zip(ids, status, final, strict=True):
        assert rows[case][0] == state
        assert rows[case][4] == (f"{1e3 * depth:.4g}" if np.isfinite(depth) else "")
    assert page.rows("values")["load.pressure"][2:] == ["50", "1e+09", "3"]
    assert page.rows("values")["upper.grip"][2:] == ["clamped", "platen", "2"]


def test_the_page_of_a_fit_has_the_numbers_of_its_file(folder, pages):
    page, told = pages["fit"], json.loads((folder / "fit/fit.json").read_text())
    estimates = next(t for t in page.tables if t[0][:2] == ["key", "estimate"])
    for row, (key, one) in zip(estimates[1:], told["parameters"].items(), strict=True):
        assert (row[0], row[3], row[6]) == (key, one["unit"], one["verdict"])
        ends = [one["estimate"], *one["interval"]]
        assert [float(row[i]) for i in (1, 4, 5)] == pytest.approx(ends, rel=5e-3)
    assert f"chi2 = {told['chi2']:.4g}" in page.text
    laws = page.rows("probability")
    assert laws["this law"][0] == "1"
    assert laws["archard"][-1] == "does not fit"
    assert len(page.drawings) >= 9  # penetrations, profiles and residuals, masses, keys
    assert any("95 % of the model" in texts for texts in page.drawings.values())


def test_what_a_fit_leaves_open_has_a_dash(folder, tmp_path):
    shutil.copytree(folder / "fit", tmp_path / "fit")
    outcome = json.loads((tmp_path / "fit/fit.json").read_text())
    open_one = {"verdict": "not identified", "interval": [None, None]}
    outcome["parameters"]["wear.lower.p0"] |= {**open_one, "direction": "as k"}
    outcome["parameters"]["wear.lower.k"] |= {"verdict": "at bound", "interval": [None, 1.25e-7]}
    outcome["p_value"] = None
    (tmp_path / "fit/fit.json").write_text(json.dumps(outcome))
    rw.report(tmp_path / "fit", tmp_path / "page.html")
    page, dash = Read((tmp_path / "page.html").read_text()), "\N{EN DASH}"
    row = page.rows("95 % from")["wear.lower.p0"]
    assert row[2:] == ["MPa", dash, dash, "not identified"]
    assert "less than 1.25e-07 1/MPa" in page.text


@pytest.mark.parametrize("kind", KINDS)
def test_pages_fetch_nothing_and_escape_texts_of_users(kind, pages, folder):
    for tag, attributes in pages[kind].elements:
        for name in ("src", "href", "action", "srcset", "poster", "data"):
            address = attributes.get(name)
            assert address is None or address.startswith(("#", "data:image/")), (tag, address)
        assert tag not in ("link", "iframe", "object", "base")
        assert tag != "img" or len(attributes["alt"]) > 20
    assert "url(" not in "".join(re.findall("<style>(.*?)</style>", pages[kind].rawdata, re.S))
    policy = next(a["content"] for _, a in pages[kind].elements if "http-equiv" in a)
    assert policy.startswith("default-src 'none';")
    assert SCRIPT not in (folder / f"{kind}.html").read_text()
    assert SCRIPT in pages[kind].text
    assert "<script" not in pages[kind].rawdata


@pytest.mark.parametrize(
    ("source", "output", "word"),
    [
        ("run.h5", "page.pdf", ".html"), ("run.h5", "away/page.html", "folder"),
        ("nothing.h5", "page.html", "exist"), ("paper.toml", "page.html", "ringwear run"),
    ],
)  # fmt: skip
def test_what_has_no_page_is_refused(source, output, word, folder, tmp_path):
    with pytest.raises(rw.InputError, match=re.escape(word)):
        rw.report(folder / source, tmp_path / output)
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("fit.json", '{"level": 0.95, "parameters": []}'),
        ("measure.json", '{"tests": {"W1": {}}}'),
        ("design.json", '{"designs": ['),
    ],
)
def test_broken_outcomes_are_refused(name, text, tmp_path):
    (tmp_path / name).write_text(text)
    with pytest.raises(rw.InputError, match=re.escape(name)):
        rw.report(tmp_path, tmp_path / "page.html")
    assert [path.name for path in tmp_path.iterdir()] == [name]
