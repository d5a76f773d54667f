"""A browser for tests of pages: Chromium, without a network."""

import shutil
import subprocess

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
in_browser = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium: apt-get install chromium has the pages opened in one"
)


#: without a window, and where nothing but this machine is found
HEADLESS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)  # fmt: skip
#: of a page that draws itself: it is over when it has been so for ten seconds of its own
BUDGET = "--virtual-time-budget=10000"


def _command(address, profile, width, words):
    return [
        CHROMIUM, *HEADLESS, f"--user-data-dir={profile}", "--enable-logging=stderr", "--v=0",
        f"--window-size={width},800", *words, address,
    ]  # fmt: skip


def opened(address, profile, *words, width=1024):
    """Open a page in Chromium.

    Returns what it prints, and what the page has said in the console, a line each.
    """
    command = _command(address, profile, width, [BUDGET, *words])
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    return done.stdout, _console(done.stderr)


def open_until(through, address, profile, width=1024):
    """Open a page in Chromium until an event, for two minutes at most; return what it has said."""
    log = profile / "stderr"
    command = _command(address, profile, width, ["--remote-debugging-port=0"])
    with log.open("w") as stderr, subprocess.Popen(command, stderr=stderr) as process:
        through.wait(120)
        process.terminate()
        process.wait(30)
    return _console(log.read_text())


def _console(text):
    return [line for line in text.splitlines() if ":CONSOLE" in line]
