"""The page of a measurement: the answer, the tables of both standards, budgets."""

import html
import json
import re

import pytest
from paths import ROOT

import ringwear_par as rw


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The outcome of the example, its page with as many repeats at another condition, its text."""
    folder = tmp_path_factory.mktemp("page")
    result = rw.measure(ROOT / "scripts/measure/measure.toml")
    result.save(folder / "out")
    path = folder / "out/measure.json"
    outcome = json.loads(path.read_text())
    outcome["repeats"].append({**outcome["repeats"][0], "tests": ["X1", "X2", "X3"]})
    path.write_text(json.dumps(outcome))
    rw.report(folder / "out", folder / "page.html")
    page = (folder / "page.html").read_text(encoding="utf-8")
    body = re.sub(r"<(script|style).*?</\1>", " ", page, flags=re.DOTALL)
    return result, page, " ".join(html.unescape(re.sub("<[^>]+>", " ", body)).split())


def test_conditions_with_equally_many_repeats_have_a_tile_each(page):
    for names in ("W1, W2, W3", "X1, X2, X3", "W4"):
        assert f"specific wear rate of {names}<" in page[1]


def test_the_tables_of_both_standards(page):
    result, _, text = page
    for words in ("ASTM C808", "ASTM G115", "pV (psi ft/min)", "W4: not steady"):
        assert words in text
    friction = result.tests[0].friction
    low, high = friction.interval
    assert f"{friction.value:.4f} from {low:.4f} to {high:.4f} (95 %)" in text


def test_every_test_has_its_budgets(page):
    *_, text = page
    for name in ("W1", "W2", "W3", "W4"):
        assert f"{name}: specific wear rate of the steady part," in text
        assert f"{name}: friction coefficient," in text
        assert f"{name}: specific wear rate of the whole test, by weighing," in text
    for source in ("readings", "steadiness", "load.force", "lower.density", "mass"):
        assert re.search(rf"\b{re.escape(source)} [AB] \d", text), source
