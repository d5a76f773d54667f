"""The explorer's command: who gets the page, ports, signals, and what is refused."""

import signal
import socket
import subprocess
import urllib.error
import urllib.request
from contextlib import contextmanager
from types import SimpleNamespace

import pytest
from commands import RINGWEAR, SHELL_ENVIRONMENT, ringwear, sentences
from paths import PAPER

import ringwear_par as rw
from ringwear_par.explorer.explore import explore


@contextmanager
def served(*words):
    """Start the command; yield its address and its process, which ends."""
    with subprocess.Popen(
        [*RINGWEAR, "explore", *map(str, words), "--no-browser"],
        env=SHELL_ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        try:
            address = process.stdout.readline().strip()
            assert address.startswith("http://localhost:"), process.stderr.read()
            yield address, process
        finally:
            process.kill()


def test_nothing_is_served_without_the_token():
    with served(PAPER, "--set", "mesh.contact_elements=12") as (address, process):
        host, token = address.rstrip("/").rsplit("/", 1)
        assert len(token) >= 32
        page = urllib.request.urlopen(address, timeout=60).read().decode()
        assert "paper.toml" in page
        assert "cdn." not in page  # all scripts come from here
        for path in ("", "/", f"/{token[:-1]}/"):
            with pytest.raises(urllib.error.HTTPError, match="404"):
                urllib.request.urlopen(host + path, timeout=60)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
        assert process.returncode == 0
        assert "Traceback" not in said


def test_a_port_and_a_signal_before_a_visit():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        refused = ringwear("explore", PAPER, "--no-browser", "--port", port)
    assert refused.returncode == 2
    assert f"--port {port}" in sentences(refused)[0]
    with served(PAPER, "--port", port) as (address, process):
        assert address.startswith(f"http://localhost:{port}/")
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0
        assert process.stderr.read() == ""


def test_several_ranks_are_refused():
    with pytest.raises(rw.InputError, match="2 ranks"):
        explore(PAPER, [], comm=SimpleNamespace(size=2), browser=False)
