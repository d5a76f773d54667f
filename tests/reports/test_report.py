"""Pages of a run, a sweep and a fit: what they say, that they fetch nothing, and in a browser."""

import base64
import itertools
import json
import re
import shutil
import sys

import h5py
import numpy as np
import pytest
from chromium import Browser, in_browser
from commands import on_ranks, ringwear
from laboratory import fit_tables, write_tests
from paths import HELPERS, PAPER
from report_pages import Read

import ringwear_par as rw
from ringwear_par.cases.units import factor as unit_factor
from ringwear_par.cases.units import with_signs
from ringwear_par.pictures.run_panels import HISTORY_PANELS
from ringwear_par.results.key_numbers import key_numbers

pytestmark = [pytest.mark.serial, pytest.mark.slow]

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
    tables = fit_tables(folder, experiments, starts=1, intervals=["linear"])
    law = {"set": {"wear.lower.law": "archard"}}
    law["parameters"] = {"wear.lower.k": tables["fit"]["parameters"]["wear.lower.k"]}
    rw.fit({**tables, "compare": {"archard": law}}, compare=True).save(folder / "fit")
    for kind, source in zip(KINDS, ("run.h5", "sweep", "fit"), strict=True):
        told = rw.report(folder / source, folder / f"{kind}.html")
        assert told.startswith(f"{folder / kind}.html: ")
    return folder


@pytest.fixture(scope="module")
def pages(folder):
    return {kind: Read((folder / f"{kind}.html").read_text()) for kind in KINDS}


def test_a_run_is_told_in_the_numbers_of_its_summary(folder, pages):
    result, page = rw.open_result(folder / "run.h5"), pages["run"]
    summary = result.summary(verbose=True)
    for line in summary.splitlines():
        assert with_signs(" ".join(line.split())) in page.text
    assert not re.search(r"\d um\b|\(um\)|\d mm3\b|\(mm3\)", page.text.partition("The case")[0])
    rows = page.rows("quantity")
    numbers = key_numbers(result)
    for number in numbers:
        if number.group not in ("lower", "upper"):
            note = f" ({number.note})" * bool(number.note)
            name = f"{number.group}, {number.label}{note}"
            assert rows[name][0] == number.short
    lower, upper = page.rows("body")["lower"], page.rows("body")["upper"]
    assert lower == [number.short for number in numbers if number.group == "lower"]
    assert upper[2] == "upper.density not given"
    errors = page.rows("check")
    held = errors["largest relative errors of all steps, contact force against the applied force"]
    assert held[0] == f"{result.balances['force']:.1e}"


def test_a_wrong_balance_has_not_passed(folder, tmp_path):
    result = rw.open_result(folder / "run.h5")
    result.attributes["balance_residual"] = 1e-2
    rw.report(result, tmp_path / "page.html")
    text = Read((tmp_path / "page.html").read_text()).text
    note = r"contact conditions \(KKT\) 1\.0e-02; balances to 1e-02, "
    assert re.search(rf"checks\s*1 wrong\s*{note}", text)
    assert "wrong: contact conditions (KKT) 1.0e-02 (balances to 1e-02, " in result.summary()


def test_charts_of_a_run_hold_what_is_stored(folder, pages):
    result, charts = rw.open_result(folder / "run.h5"), pages["run"].charts
    drawn = HISTORY_PANELS.keys() - {"through"}  # of layers
    assert set(charts) == {"wear-lower", "wear-upper", "pressure", *drawn}
    ((time, depth),) = charts["penetration"].curves().values()
    assert np.allclose(depth, 1e3 * result.histories["penetration"], rtol=1e-6)
    assert np.allclose(time, result.histories["time"])
    frames = charts["wear-lower"].frames
    assert np.allclose(frames, 1e3 * result.profiles["wear_lower"], rtol=1e-6)
    assert charts["wear-lower"].columns["lines"]["y"][-1] == frames[-1]
    assert charts["wear-lower"].columns["dots"]["y"] == frames[-1]
    assert charts["volume"].curves().keys() == {"lower", "upper"}
    assert charts["rate"].columns["lines"]["stepped"] == [True, True]
    hollow = charts["pressure"].columns["points"]
    assert set(hollow["label"]) <= {"contact edge"}
    assert set(hollow["fill"]) <= {None}


def test_the_case_is_told_in_words_and_as_text(folder, pages):
    words = pages["run"].rows("how")
    assert words["lower body"][0].startswith("ring of radii 20 to 40 mm, height 20 mm; Young's")
    assert "contact face: flat; density 0.0078" in words["lower body"][0]
    law = rw.open_result(folder / "run.h5").attributes["law_upper"]
    assert words["wear of upper"] == [f"{law} (2e-05 mm\N{SUPERSCRIPT THREE}/(N m))"]
    assert "mean pressure 80 MPa" in words["load"][0]
    assert words["time"] == ["8 implicit steps of 1 s, 8 s in all"]
    stored = rw.open_result(folder / "run.h5").case
    assert " ".join(stored.split()) in pages["run"].text


def test_a_sweep_is_told_with_its_failures(folder, pages):
    page, ensemble = pages["sweep"], rw.open_ensemble(folder / "sweep")
    with ensemble:
        ids, status = ensemble["case"].values, ensemble["status"].values
        final = ensemble["final_penetration"].values
    failed = int((status == "failed").sum())
    assert 0 < failed < len(ids)
    assert f"{failed} of {len(ids)} cases failed" in page.text
    worst, table = (table for table in page.tables if "status" in table[0])
    rows = {row[0]: row[1:] for row in table[1:]}
    assert list(rows) == list(ids)
    states, depths = ([row[1] for row in worst[1:]], [row[5] for row in worst[1:]])
    assert len(states) == 10
    assert states == [*["failed"] * failed, *["done"] * 10][:10]
    sizes = [float(depth) for depth in depths[failed:]]
    assert sizes == sorted(sizes, reverse=True)
    assert table[0][3:6] == ["mean pressure (kPa)", "grip, upper", "penetration (\N{MICRO SIGN}m)"]
    assert {row[2] for row in rows.values()} == {"5e+04", "1e+05", "1e+12"}
    for case, state, depth in zip(ids, status, final, strict=True):
        assert rows[case][0] == state
        assert rows[case][4] == (f"{1e3 * depth:.4g}" if np.isfinite(depth) else "")
    assert page.rows("values")["load.pressure"][2:] == ["5e+04", "1e+12", "3"]
    assert page.rows("values")["upper.grip"][2:] == ["clamped", "platen", "2"]
    assert {row[3] for row in rows.values()} == {"clamped", "platen"}


def points(page):
    """What the points of a page's charts are, in words."""
    (told,) = (text for text in page.scripts if text.startswith("["))
    return [text.split("\n") for text in json.loads(told)]


def test_charts_of_a_sweep_name_cases_and_their_values(folder, pages):
    charts, told = pages["sweep"].charts, points(pages["sweep"])
    with rw.open_ensemble(folder / "sweep") as ensemble:
        done = ensemble.isel(case=np.flatnonzero(ensemble["status"] == "done")).load()
    assert [words[0] for words in told] == [f"case {name}" for name in done["case"].values]
    chart = charts["effect-penetration-wear-lower-k"]
    drawn = chart.columns["points"]
    at = np.array(drawn["case"])
    assert sorted(at[at >= 0]) == list(range(20))
    for name, values in (("y", 1e3 * done["final_penetration"]), ("x", done["wear.lower.k"])):
        assert np.allclose(np.array(drawn[name])[at >= 0], values.values[at[at >= 0]], rtol=1e-6)
    for words, k, grip in zip(
        told, done["wear.lower.k"].values, done["upper.grip"].values, strict=True
    ):
        assert np.isclose(float(words[1].rpartition(" = ")[2]), k, rtol=1e-2)
        assert words[3] == f"grip, upper = {grip}"
    fan = charts["histories"].curves()
    last = 1e3 * done["final_penetration"].values
    assert np.isclose(fan["median"][1][-1], np.median(last))
    assert np.isclose(fan["95 %"][1][-1], np.quantile(last, 0.95))


def test_a_fit_is_told_as_its_file_has_it(folder, pages):
    page, told = pages["fit"], json.loads((folder / "fit/fit.json").read_text())
    estimates = next(t for t in page.tables if t[0][:2] == ["key", "estimate"])
    for row, (key, one) in zip(estimates[1:], told["parameters"].items(), strict=True):
        low, high = one["interval"]
        assert row == [key, f"{one['estimate']:.5g}", f"{one['sd']:.2g}", one["unit"],
                       f"{low:.5g}", f"{high:.5g}", one["verdict"]]  # fmt: skip
    assert f"chi2 = {told['chi2']:.5g}" in page.text
    laws = page.rows("AIC above the smallest")
    assert laws["this law"][0] == "+0.0"
    assert laws["archard"][-1] == "does not fit"
    assert len(page.charts) == 12  # penetrations and profiles with residuals, masses, keys
    with h5py.File(folder / "fit/results.h5") as file:
        group = file[next(name for name in file if name.startswith("1_"))]
        stored = {n: group[n][()] for n in ("time", "data", "model", "band", "sd")}
        unit = 1.0 / unit_factor(group.attrs["data_unit"], "mm")
    chart = page.charts["series-1"]
    order = np.argsort(stored["time"], kind="stable")
    for name, sign, sd in (
        ("model", 0.0, 0.0), ("95 % of the model, from", -1.0, stored["band"]),
        ("95 % of readings, from", -1.0, np.hypot(stored["band"], stored["sd"])),
    ):  # fmt: skip
        end = unit * (stored["model"] + sign * 1.959964 * sd)[order]
        assert np.allclose(chart.curves()[name][1], end, rtol=1e-5), name
    assert chart.columns["ribbons"]["label"] == ["95 % of readings", "95 % of the model"]
    ribbon, low = chart.columns["ribbons"]["y"][1], chart.curves()["95 % of the model, from"][1]
    assert np.array_equal(ribbon[: len(low)], low)
    assert len(ribbon) == 2 * len(low)
    assert "from the covariance of the fitted keys" in page.text
    strip = page.charts["single"].columns
    assert strip["points"]["label"] == ["data"]
    assert strip["bars"]["label"] == ["95 % of readings", "95 % of the model"]
    assert page.charts["keys-1-0"].curves().keys() >= {"68 % ellipse", "95 % ellipse"}


def test_what_a_fit_leaves_open_and_a_design_are_told(folder, tmp_path):
    shutil.copytree(folder / "fit", tmp_path / "fit")
    told = json.loads((tmp_path / "fit/fit.json").read_text())
    one = {"verdict": "not identified", "sd": None, "interval": [None, None], "direction": "as k"}
    told["parameters"]["wear.lower.p0"] |= one
    one = {"verdict": "at bound", "interval": [None, 1.25e-7]}
    told["parameters"]["wear.lower.k"] |= one
    told["doubts"], told["p_value"] = [{"text": "p0 is a guess"}], None
    told["covariance"][1][1] = None
    told["alternatives"]["power"] = {"error": "no history"}
    (tmp_path / "fit/fit.json").write_text(json.dumps(told))
    sd = {"sd": {"wear.lower.k": 1e-9, "wear.lower.p0": None}}
    tests = [{"load.pressure": 30.0, "time.end": 100.0}, {"load.pressure": 90.0}]
    design = {
        "parameters": {"wear.lower.k": 1e-7, "wear.lower.p0": 3.0}, "candidates": 12,
        "criterion": "D", "measured_as": "test 1", "fit_file": sd,
        "designs": [
            {"name": "30 then 90 MPa", "experiments": tests, "seconds": 36000.0, **sd}
        ],
        "map": None, "sd_scales": {
            "wear.lower.k": {"factor": 1e9, "unit": "%"}, "wear.lower.p0": {"factor": 1, "unit": ""}
        },
    }  # fmt: skip
    (tmp_path / "fit/design.json").write_text(json.dumps(design))
    rw.report(tmp_path / "fit", tmp_path / "page.html")
    page = Read((tmp_path / "page.html").read_text())
    dash = "\N{EN DASH}"
    assert page.rows("95 % from")["wear.lower.p0"][1:] == [
        dash, "MPa", dash, dash, "not identified"
    ]  # fmt: skip
    assert "p0 is a guess" in page.text
    assert re.search(r"wear.lower.k\s*less than 1.25e-07 1/MPa\s*95 %, at bound", page.text)
    assert ("p", {"class": "warning"}) in page.elements
    assert page.rows("AIC above the smallest")["power"][-1] == "failed: no history"
    assert page.rows("tests")["1"] == ["30 then 90 MPa", "10 h", "1", dash]


@pytest.mark.parametrize("kind", KINDS)
def test_pages_fetch_nothing(kind, pages):
    for tag, attributes in pages[kind].elements:
        for name in ("src", "href", "action", "srcset", "poster", "data"):
            address = attributes.get(name)
            assert address is None or address.startswith(("#", "data:image/")), (tag, address)
        assert tag not in ("link", "iframe", "object", "base")
    assert "url(" not in "".join(re.findall("<style>(.*?)</style>", pages[kind].rawdata, re.S))
    policy = next(a["content"] for _, a in pages[kind].elements if "http-equiv" in a)
    assert policy.startswith("default-src 'none';")
    assert "http" not in policy


@pytest.mark.parametrize("kind", KINDS)
def test_texts_of_users_are_escaped(kind, pages, folder):
    assert SCRIPT not in (folder / f"{kind}.html").read_text()
    assert SCRIPT in pages[kind].text
    assert not any(text.startswith("alert") for text in pages[kind].scripts)


@pytest.mark.parametrize("kind", KINDS)
def test_pages_are_made_for_everybody(kind, pages):
    elements = pages[kind].elements
    assert ("html", {"lang": "en-GB"}) in elements
    levels = [int(tag[1]) for tag, _ in elements if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b <= a + 1 for a, b in itertools.pairwise(levels))
    for tag, attributes in elements:
        if tag == "img":
            assert len(attributes["alt"]) > 30
        if attributes.get("role") == "img":
            assert attributes["aria-label"]
        if tag == "th":
            assert attributes["scope"] in ("row", "col")
    assert sum(tag == "caption" for tag, _ in elements) == len(pages[kind].tables)
    names = [a["id"] for _, a in elements if "id" in a]
    assert len(names) == len(set(names))


def test_a_run_with_little_stored_has_a_page(tmp_path):
    words = {"output.profiles": "last", "contact.friction": 0.0, "time.steps": 2}
    result = rw.simulate(rw.read_case(PAPER, {**CASE, **words}))
    told = rw.report(result, tmp_path / "page.html")
    page = Read((tmp_path / "page.html").read_text())
    assert "No profiles are stored" in page.text
    assert HISTORY_PANELS.keys() - page.charts.keys() == {"through"}  # no layers
    assert told.endswith(f"{len(HISTORY_PANELS)} figures")


@pytest.mark.parametrize(
    ("source", "output", "words"),
    [
        ("run.h5", "page.pdf", ".html"), ("run.h5", "away/page.html", "folder"),
        ("nothing.h5", "page.html", "nothing.h5"), ("paper.toml", "page.html", "ringwear run"),
        ("empty", "page.html", "fit.json"), ("rough", "page.html", "damaged"),
        ("torn", "page.html", "damaged"), ("broken", "page.html", "damaged"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(source, output, words, folder, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken/fit.json").write_text('{"level": 0.95, "parameters": []}')
    (tmp_path / "rough").mkdir()
    (tmp_path / "rough/measure.json").write_text('{"tests": {"W1": {}}}')
    (tmp_path / "torn").mkdir()
    (tmp_path / "torn/design.json").write_text('{"designs": [')
    place = tmp_path if (tmp_path / source).is_dir() else folder
    before = {p.name for p in tmp_path.iterdir()}
    with pytest.raises(rw.InputError) as refused:
        rw.report(place / source, tmp_path / output)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)
    assert {p.name for p in tmp_path.iterdir()} == before


def test_missing_packages_are_told(folder, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "bokeh", None)
    with pytest.raises(rw.InputError, match=r"pip install 'ringwear-par\[report\]'"):
        rw.report(folder / "run.h5", tmp_path / "page.html")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ranks", on_ranks(2))
def test_the_command(ranks, folder, tmp_path):
    done = ringwear("report", folder / "run.h5", "-o", tmp_path / "page.html", ranks=ranks)
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{tmp_path}/page.html: Wear history of a test, 13 figures\n"
    assert (tmp_path / "page.html").read_bytes() == (folder / "run.html").read_bytes()
    assert [p.name for p in tmp_path.iterdir()] == ["page.html"]


# -- in a browser ----------------------------------------------------------------------------------

#: what a page says of itself
PROBE = (HELPERS / "report_probe.js").read_text("utf-8")


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("chromium"), width=1024, height=800) as browser:
        yield browser


@in_browser
@pytest.mark.parametrize("kind", KINDS)
def test_a_browser_draws_the_page_and_prints_it_on_a4(kind, folder, pages, browser):
    browser.said.clear()
    browser.open((folder / f"{kind}.html").as_uri())
    printed = base64.b64decode(browser.call("Page.printToPDF", preferCSSPageSize=True)["data"])
    boxes = re.findall(rb"/MediaBox \[([-0-9. ]+)\]", printed)
    assert boxes
    for box in boxes:
        assert np.allclose([float(v) for v in box.split()], [0, 0, 595, 842], atol=1.0)
    told = browser.run(PROBE)
    assert browser.said == []  # no error, no warning
    assert told["width"] == 1024
    charts = list(pages[kind].charts.values())
    for drawn, chart in zip(told["plots"], charts, strict=True):
        kinds = {k: len(next(iter(columns.values()))) for k, columns in chart.columns.items()}
        assert drawn == kinds
        assert sum(kinds.values())
    assert set(told["buttons"]) == {
        "PanTool", "BoxZoomTool", "ZoomInTool", "ZoomOutTool", "ResetTool", "SaveTool", "HoverTool"
    }  # fmt: skip
    assert all(told["pictures"])
    assert len(told["pictures"]) == (kind == "run")  # the rig
    assert told["repeated"] == ["contents"]
    if kind == "sweep":
        check_pointed(told["points"], charts)
    assert all(told["focused"])
    assert len(told["focused"]) > 4
    if kind == "run":
        assert told["slid"] == ["0 s", pages["run"].charts["wear-lower"].frames[0]]
        assert [float(word) for word in told["slid_numbers"]] == told["slid"][1]
    check_by_hand(told, charts)
    check_paper(told["widths"], {"run": 0, "sweep": 1, "fit": 1}[kind])
    if kind == "sweep":
        up, down = ([float(word) for word in words] for words in told["sorted"])
        assert len(set(up)) > 10
        assert up == sorted(up) == down[::-1]
        assert told["order"] == "descending"


def check_pointed(words, charts):
    """Check that curves and points of cases are named by the case and its keys."""
    for texts, chart in zip(words, charts, strict=True):
        lines = chart.columns["lines"]["words"] + chart.columns["asides"]["words"]
        cases = [text for text, case in zip(texts, chart.columns["points"]["case"], strict=True)
                 if case >= 0]  # fmt: skip
        assert cases or any(lines) or chart.columns["bars"]["y"]
        for text in filter(None, [*lines, *cases]):
            assert text.startswith("case ")
            assert "wear coefficient k, lower (1/MPa) = " in text


def check_paper(widths, whole):
    """Check that charts are as wide as A4 has room for, and then as before."""
    screen, on_paper, after = widths
    assert sorted(on_paper) == [330] * (len(on_paper) - whole) + [680] * whole
    assert after == screen
    assert max(screen) <= 980


def check_by_hand(told, charts):
    """Check tables of the charts' numbers, and what the buttons of the first one do."""
    (x, y), near, right, up, whole = (np.array(ranges) for ranges in told["ranges"])
    assert np.allclose(near, [np.mean(v) + 0.25 * np.diff(v) * [-1, 1] for v in (x, y)])
    assert np.allclose(right, np.add(near, [[0.25 * np.ptp(near[0])], [0.0]]))
    assert np.allclose(up, np.add(right, [[0.0], [0.25 * (near[1][1] - near[1][0])]]))
    assert np.allclose(whole, [x, y])
    assert len(told["numbers"]) == len(charts)
    for rows, chart in zip(told["numbers"], charts, strict=True):
        assert all(rows[0])
        if ends := chart.columns["bars"]["right"]:  # behind curves and points
            assert [float(row[1]) for row in rows[1:]][-len(ends) :] == ends
            continue
        if rows[0][0] == "curve":
            written = [row[2] for row in rows[1:]]
        else:  # beside each other
            written = [row[i] for i in range(1, len(rows[0])) for row in rows[1:]]
        assert len(written) == len(chart.ordinates)
        for text, value in zip(written, chart.ordinates, strict=True):
            assert (text == "") == (not np.isfinite(value))
            assert not text or np.isclose(float(text), value)
