"""The explorer in headless Chromium: sliders are moved, figures and numbers follow."""

import base64
import re
import signal
import time

import numpy as np
import pytest
from chromium import Browser, in_browser
from explorer_server import served
from paths import CASES, FIT, PAPER

import ringwear_par as rw
from ringwear_par.cases.units import with_signs

pytestmark = [pytest.mark.serial, pytest.mark.slow, in_browser]

#: what is drawn and told once nothing is under way
REST = "page.drawn > 0 && !page.flying && !page.waiting && page.n >= {n}"
LINES = "page.talk.document.get_model_by_name('{name}-{kind}').data"


@pytest.fixture(scope="module")
def explorer(tmp_path_factory):
    """A page of the paper's case with its process, its browser, and a folder."""
    folder = tmp_path_factory.mktemp("explorer")
    words = ["--set", "mesh.contact_elements=16", "load.omega=34 rpm", "time.steps=20"]
    with served(PAPER, *words) as (address, process), Browser(folder / "profile") as browser:
        browser.open(address)
        browser.wait(REST.format(n=0))
        browser.address, browser.process, browser.folder = address, process, folder
        yield browser


@pytest.fixture
def page(explorer):
    """The page, as it is when it is opened."""
    explorer.run("find('reset').click()")
    rest(explorer)
    explorer.run("document.querySelectorAll('#laid button').forEach((b) => b.click())")
    explorer.wait("find('laid').hidden")
    assert explorer.said == []
    yield explorer
    assert explorer.said == []  # no error, no warning


def rest(page):
    """Wait until nothing is asked for any more."""
    page.wait(REST.format(n=0))


def shown(page, name, kind="lines"):
    return page.run(LINES.format(name=name, kind=kind))


def at_home(page):
    """The case that is taken home, and its history."""
    path = page.folder / "home.toml"
    path.write_text(page.run("find('case').textContent"))
    case = rw.read_case(path)
    return case, rw.simulate(case)


def agrees(page):
    """Whether the page shows the very history of the case file that it shows."""
    case, result = at_home(page)
    depth = shown(page, "penetration")
    assert depth["y"][-1] == (1e3 * result.histories["penetration"]).tolist()
    assert depth["x"][-1] == result.histories["time"].tolist()
    assert shown(page, "wear")["y"][-1] == (1e3 * result.profiles["wear_lower"][-1]).tolist()
    assert shown(page, "pressure")["y"][-1] == result.profiles["pressure"][-1].tolist()
    assert page.run("find('summary').textContent") == with_signs(result.summary())
    told = page.run("[...find('numbers').tBodies[0].rows].map((r) => [...r.cells].map("
                    "(c) => c.textContent))")  # fmt: skip
    numbers = {row[0]: row[1] for row in told}
    assert numbers["penetration, total"] == f"{1e3 * result.histories['penetration'][-1]:.4g}"
    return case, result


def test_the_page_opens_and_asks_nobody_else(page):
    agrees(page)
    origin = re.match("http://[^/]+/", page.address)[0]
    assert page.asked_for
    for address in page.asked_for:
        assert address.startswith((origin, f"ws{origin[4:]}", "data:", "blob:")), address
    for address in page.asked_for:
        assert not address.startswith(origin) or address.startswith(
            (page.address, f"{origin}favicon.ico")
        )
    for width in (1280, 800, 500):
        page.call("Emulation.setDeviceMetricsOverride", width=width, height=900,
                  deviceScaleFactor=1, mobile=False)  # fmt: skip
        page.wait(f"document.documentElement.scrollWidth === {width}", 10)
    page.call("Emulation.setDeviceMetricsOverride", width=1280, height=900, deviceScaleFactor=1,
              mobile=False)  # fmt: skip


def test_sliders_move_by_keys_and_all_follows(page):
    before = at_home(page)[0]
    page.run("find('load.omega').focus()")
    for key, code, times in (("ArrowRight", 39, 5), ("PageUp", 33, 1), ("ArrowLeft", 37, 1)):
        for _ in range(times):
            page.key(key, code)
    rest(page)
    case, _ = agrees(page)
    assert case.load.omega > before.load.omega
    box = page.run("controls.get('load.omega').box.value")
    assert f'omega = "{box} rpm"' in page.run("find('case').textContent")
    assert page.run("find('load.omega').getAttribute('aria-valuetext')") == f"{box} rpm"
    old = shown(page, "penetration")["y"][0]  # the case file's stays to be seen
    assert old == (1e3 * rw.simulate(before).histories["penetration"]).tolist()
    page.run("controls.get('wear.lower.k').box.focus()")
    page.run("controls.get('wear.lower.k').box.select()")
    page.call("Input.insertText", text="3e-5 mm3/(N m)")
    page.key("Enter", 13)
    page.call("Input.dispatchKeyEvent", type="char", text="\r")
    rest(page)
    case, _ = agrees(page)
    assert case.wear_lower.k == pytest.approx(3e-8)


def test_drags_do_not_queue_up(page):
    moves = 120
    asked = page.run("page.n")
    page.run(f"""new Promise((done) => {{
      const range = find("wear.lower.k"); let i = 0;
      const id = setInterval(() => {{
        range.value = -7 + i / {moves}; range.dispatchEvent(new Event("input"));
        if (++i <= {moves}) return;
        clearInterval(id); range.dispatchEvent(new Event("change")); done();
      }}, 4);
    }})""")
    late = page.run("page.n")
    rest(page)
    assert page.run("page.n") - late <= 3  # what is under way, the last request, and its rest
    case, _ = agrees(page)
    assert case.wear_lower.k == pytest.approx(1e-6, rel=1e-2)
    assert 0 < page.run("page.n") - asked <= moves + 3


def test_geometry_waits_until_it_is_let_go(page):
    asked = page.run("page.n")
    page.run("""(() => {
      window.words = new Set();
      new MutationObserver(() => words.add(find("status").textContent)).observe(
        find("status"), { childList: true, characterData: true, subtree: true });
      const range = find("upper.r[0]");
      for (const value of [28.6, 28.7, 28.8]) {
        range.value = value; range.dispatchEvent(new Event("input"));
      }
    })()""")
    assert page.run("page.n") == asked
    page.run("find('upper.r[0]').dispatchEvent(new Event('change'))")
    page.wait(REST.format(n=asked + 1))
    case, _ = agrees(page)
    assert case.upper.r == (28.8, 31.5)
    words = page.run("[...words]")
    assert "Let go to assemble the bodies anew." in words
    assert "Assembling the bodies \u2026" in words


def test_measurements_are_laid_over(page):
    page.choose_files("#file", FIT / "test2_penetration.csv")
    page.wait("find('laid').tBodies[0].rows.length === 1")
    rows = np.loadtxt(FIT / "test2_penetration.csv", delimiter=",", skiprows=2)
    points = shown(page, "penetration", "points")
    assert np.allclose(points["x"], rows[:, 0])
    assert np.allclose(points["y"], rows[:, 1])
    table = base64.b64encode(b"r_um,depth_um\n29000,3\n30000,2\n").decode()
    page.run(f"""(() => {{
      const bytes = Uint8Array.from(atob("{table}"), (c) => c.charCodeAt(0));
      const dataTransfer = new DataTransfer();
      dataTransfer.items.add(new File([bytes], "trace.csv"));
      document.body.dispatchEvent(new DragEvent("drop", {{ dataTransfer, bubbles: true }}));
    }})()""")
    page.wait("find('laid').tBodies[0].rows.length === 2")
    points = shown(page, "wear", "points")
    assert np.allclose(points["x"], [29.0, 30.0])
    assert np.allclose(points["y"], [3.0, 2.0])
    _, result = at_home(page)
    told = page.run("find('laid').tBodies[0].rows[1].innerText")
    model = np.interp([29.0, 30.0], result.line.r, 1e3 * result.profiles["wear_lower"][-1])
    assert f"{np.sqrt(np.mean((model - [3.0, 2.0]) ** 2)):.3g} \N{MICRO SIGN}m" in told
    menu = "find('laid').querySelectorAll('select')"
    page.run(f"{menu}[0].value = 'approach'; {menu}[0].dispatchEvent(new Event('change'))")
    page.wait("find('menu').value === 'approach' && !page.flying")
    page.wait("page.talk.document.get_model_by_name('other-points').data.x.length === 150")
    assert len(shown(page, "penetration", "points")["x"]) == 0
    bad = base64.b64encode(b"a,b\n1,2\n").decode()
    page.run(f"give({{ name: 'bad.csv', content: '{bad}' }})")
    page.wait("!find('laid-fault').hidden")
    assert "bad.csv: has the columns a, b" in page.run("find('laid-fault').textContent")


def test_faults_are_said_and_go(page):
    good = shown(page, "penetration")["y"][-1]
    page.run("""(() => { const box = controls.get("upper.r[0]").box;
      box.value = "45"; box.dispatchEvent(new Event("change")); })()""")
    page.wait("find('faults').textContent")
    rest(page)
    said = page.run("find('faults').textContent")
    assert "upper.r = [45.0, 31.5]: must be two increasing numbers" in said
    assert page.run("find('figures').classList.contains('old')")
    assert shown(page, "penetration")["y"][-1] == good
    page.run("find('reset').click()")
    page.wait("!find('faults').textContent")
    assert not page.run("find('figures').classList.contains('old')")
    agrees(page)


def test_the_address_keeps_the_state(page):
    """Numbers, chart and the pinned variant come back; what was set is undone by a key."""
    change = """(() => {{ const box = controls.get("{}").box;
      box.value = "{}"; box.dispatchEvent(new Event("change")); }})()"""
    page.run(change.format("load.omega", "40"))
    rest(page)
    page.run("find('pin').click()")
    page.run("find('menu').value = 'torque'; find('menu').dispatchEvent(new Event('change'))")
    page.run(change.format("load.omega", "50"))
    rest(page)
    seen = "[...find('answers').rows].map((r) => [...r.cells].map((c) => c.textContent))"
    answers, address = page.run(seen), page.run("location.href")
    assert answers[0] == ["at the end", "now", "case file", "pinned"]
    page.run("window.left = true")
    page.call("Page.reload")
    page.wait("!window.left && typeof page !== 'undefined' && page.drawn > 0")
    rest(page)
    assert page.run("location.href") == address
    assert page.run(seen) == answers
    assert page.run("find('menu').value") == "torque"
    assert page.run("controls.get('load.omega').box.value") == "50"
    for _ in range(2):
        page.run(change.format("load.omega", "x"))
        rest(page)
        assert page.run("controls.get('load.omega').row.classList.contains('wrong')")
        assert page.run("controls.get('load.omega').fault.textContent").startswith("load.omega = x")
        page.run("document.activeElement.blur()")
        page.call("Input.dispatchKeyEvent", type="rawKeyDown", key="z", modifiers=2,
                  windowsVirtualKeyCode=90)  # fmt: skip
        rest(page)
        page.wait("controls.get('load.omega').box.value === '50'")
    assert page.run(seen) == answers
    page.run("find('pin').click(); find('menu').value = 'volume'")
    page.run("find('menu').dispatchEvent(new Event('change'))")
    page.run("find('reset').click()")
    rest(page)
    assert "#" not in page.run("location.href")


def test_times_and_charts_are_chosen(page):
    page.run("find('instant').value = 0.5; find('instant').dispatchEvent(new Event('input'))")
    page.run("find('menu').value = 'rate'; find('menu').dispatchEvent(new Event('change'))")
    page.wait("find('chosen').textContent === '10 s' && !page.flying && !page.waiting")
    _, result = at_home(page)
    assert shown(page, "wear")["y"][-1] == (1e3 * result.profiles["wear_lower"][10]).tolist()
    page.wait("page.talk.document.get_model_by_name('other').left[0].axis_label.includes('rate')")
    page.run("find('instant').value = 1; find('instant').dispatchEvent(new Event('input'))")
    rest(page)


def test_the_case_is_taken_home_and_runs(page):
    page.run("""(() => { const box = controls.get("load.omega").box;
      box.value = "50"; box.dispatchEvent(new Event("change")); })()""")
    rest(page)
    page.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(page.folder))
    page.run("find('download').click()")
    saved = page.folder / "explored.toml"
    until = time.monotonic() + 60.0
    while not (saved.exists() and saved.stat().st_size) and time.monotonic() < until:
        time.sleep(0.02)
    assert 'omega = "50 rpm"' in saved.read_text()
    depth = 1e3 * rw.simulate(rw.read_case(saved)).histories["penetration"]
    assert shown(page, "penetration")["y"][-1] == depth.tolist()


def test_everything_is_reached_by_keys_and_has_a_name(page):
    page.run("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    told = page.run("""[...document.querySelectorAll("input, select, button, summary, a, pre")]
      .filter((e) => e.offsetParent !== null).map((e) => { e.focus(); return [
        e.id || e.tagName, document.activeElement === e,
        Boolean(e.labels?.length || e.ariaLabel || e.textContent.trim())]; })""")
    assert len(told) > 30
    assert [row for row in told if not (row[1] and row[2])] == []
    tree = page.call("Accessibility.getFullAXTree")["nodes"]
    sliders = [n for n in tree if n.get("role", {}).get("value") == "slider"]
    assert len(sliders) > 14
    assert all(n["name"]["value"] for n in sliders)


@pytest.mark.parametrize("name", ["user_law", "updated", "wear_through"])
def test_cases_of_other_kinds(name, explorer, tmp_path):
    """Last, as the page of the paper's case is left."""
    words, page = ["--set", "mesh.contact_elements=16"], explorer
    with served(CASES / f"{name}.toml", *words) as (address, _):
        page.open(address)
        page.wait(REST.format(n=0))
        first = page.run("page.talk.answer")
        page.run("""(() => { const row = document.querySelector("[data-name^='wear.']");
          const range = row.querySelector("input");
          range.value = Number(range.value) + 20 * Number(range.step);
          range.dispatchEvent(new Event("input"));
          range.dispatchEvent(new Event("change")); })()""")
        page.wait(REST.format(n=1))
        assert page.run("page.talk.answer") != first
        assert page.run("find('faults').textContent") == ""
        path = tmp_path / "home.toml"
        path.write_text(page.run("find('case').textContent"))
        result = rw.simulate(rw.read_case(path))
        depth = shown(page, "penetration")
        assert depth["y"][-1][-1] == 1e3 * result.histories["penetration"][-1]
        assert page.said == []
        page.open("about:blank")


def test_the_page_says_that_the_program_has_ended(explorer):
    with served(PAPER, "--set", "time.steps=3") as (address, process):
        explorer.open(address)
        explorer.wait(REST.format(n=0))
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
        explorer.wait("find('faults').textContent.includes('The connection is lost')")
