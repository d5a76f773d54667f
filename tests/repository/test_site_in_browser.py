"""The built site in a browser: every page, wide and narrow, drawn without a fault.

``scripts/docs.sh`` builds it.
"""

import functools
import http.server
import json
import threading
from urllib.parse import unquote, urlsplit

import pytest
from chromium import Browser, in_browser
from paths import HELPERS, ROOT

SITE = ROOT / "docs" / "_build" / "html"
WIDTHS = (1280, 400)
SOUGHT, FOUND = "search.html?q=wear+coefficient", 10

pytestmark = [
    pytest.mark.serial,
    in_browser,
    pytest.mark.skipif(
        not (SITE / "index.html").exists(), reason="no site: bash scripts/docs.sh builds it"
    ),
]

#: opens the pages one after another in a frame, and tells what each has become
DRIVER = (HELPERS / "site_driver.html").read_text("utf-8")


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """What the browser tells of each page at each width, what it said, and what it did not get."""
    pages = sorted(
        str(path.relative_to(SITE))
        for path in SITE.rglob("*.html")
        if "_static" not in path.relative_to(SITE).parts
    )
    pages = [SOUGHT if page == "search.html" else page for page in pages]
    driver = DRIVER.replace("WIDTHS", str(list(WIDTHS))).replace("PAGES", json.dumps(pages))
    driver = driver.replace("FOUND", str(FOUND))
    refused = []

    class Served(http.server.SimpleHTTPRequestHandler):
        def do_GET(self):
            if self.path != "/driver":
                return super().do_GET()
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.end_headers()
            return self.wfile.write(driver.encode())

        def log_request(self, code="-", size="-"):
            if int(code) >= 400:
                refused.append(self.path)

        def log_message(self, *words):
            pass

    handler = functools.partial(Served, directory=str(SITE))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with Browser(tmp_path_factory.mktemp("profile"), width=WIDTHS[0] + 50) as browser:
            browser.open(f"http://127.0.0.1:{server.server_port}/driver")
            found, said = browser.run("lookAtAll()"), browser.said
        server.shutdown()
    assert len(pages) > 50
    assert len(found) == len(WIDTHS) * len(pages)
    return found, said, refused


def test_pages_say_nothing_in_the_console_and_get_what_they_ask_for(seen):
    _, said, refused = seen
    assert not refused
    assert said == []  # no error, no warning, no request away from here


def test_pages_show_what_they_hold(seen):
    for page in seen[0]:
        at = page["page"], page["width"]
        assert page["text"] > 20, at
        assert not page["broken"], at
        assert not page["flat"], at
        assert not page["bare"], at  # formulas and roles that were not understood
    wide = {page["page"]: page for page in seen[0] if page["width"] == WIDTHS[0]}
    assert wide["model.html"]["formulas"] > 20
    assert wide["index.html"]["pictures"] == 6
    assert wide["generated/gallery/index.html"]["pictures"] >= 12


def test_the_search_leads_to_what_a_word_means_and_shows_it(seen):
    (search,) = (page for page in seen[0] if page["page"] == SOUGHT and page["width"] == WIDTHS[0])
    assert len(search["found"]) > FOUND
    assert search["found"][0].endswith("glossary.html#term-wear-coefficient")
    assert not any("changelog" in address for address in search["found"])
    assert search["excerpts"] > 0.8 * len(search["found"])


def test_pages_are_as_wide_as_the_window(seen):
    """What is wider, such as tables and formulas, scrolls by itself."""
    for page in seen[0]:
        at = page["page"], page["width"]
        assert page["scrolls"] <= page["width"], at
        assert not page["wide"], at


def test_links_lead_to_pages_of_the_site(seen):
    known = set()
    for page in seen[0]:
        for link in page["links"]:
            address = urlsplit(link)
            if address.hostname == "127.0.0.1":
                known.add(address.path)
    assert len(known) > 50
    assert not [path for path in known if not (SITE / unquote(path).strip("/")).exists()]
