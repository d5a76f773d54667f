"""The explorer's server: who gets the page, ports, signals, and what is refused."""

import asyncio
import re
import signal
import socket
import sys
from contextlib import suppress
from types import SimpleNamespace

import pytest
from commands import ringwear, sentences
from explorer_server import served
from paths import CASES, PAPER
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

import ringwear_par as rw
from ringwear_par.cli import main

pytestmark = pytest.mark.serial
SMALL = ["mesh.contact_elements=12", "time.steps=8"]


async def _answers(address):
    client, codes = AsyncHTTPClient(), {}
    host, token = re.fullmatch(r"http://([^/]+)/([^/]+)/", address).groups()
    wrong = f"{token[:-1]}{'a' if token[-1] != 'a' else 'b'}"
    for prefix in ("", f"{token}/", f"{wrong}/", f"{token[:-1]}/"):
        for name in ("", "ws", "metadata", "autoload.js", "static/js/bokeh.min.js"):
            done = await client.fetch(f"http://{host}/{prefix}{name}", raise_error=False)
            codes[prefix.rstrip("/"), name] = done.code
    page = (await client.fetch(address)).body.decode()
    found = re.search(r'"token":"([^"]+)"', page)[1]
    for origin in (f"http://{host}", "http://evil.example", "null"):
        asked = HTTPRequest(f"ws://{host}/{token}/ws", headers={"Origin": origin})
        with suppress(HTTPClientError):
            socket = await websocket_connect(asked, subprotocols=["bokeh", found])
            codes[origin] = (await asyncio.wait_for(socket.read_message(), 20)) is not None
            socket.close()
    port = host.rpartition(":")[2]
    for name in (f"localhost:{port}", f"[::1]:{port}", f"evil.example:{port}", "127.0.0.1:1"):
        done = await client.fetch(address, headers={"Host": name}, raise_error=False)
        codes[name.replace(port, "PORT")] = done.code
    return token, host, codes, page


def test_nobody_gets_anything_without_the_token():
    with served(PAPER, "--set", *SMALL) as (address, process):
        token, host, codes, page = asyncio.run(_answers(address))
        assert len(token) >= 32
        for (prefix, _), code in [(k, v) for k, v in codes.items() if isinstance(k, tuple)]:
            assert (code == 404) is (prefix != token), (prefix, code)
        assert codes[token, ""] == 200
        assert codes[f"http://{host}"] is True
        assert [codes[f"{name}:PORT"] for name in ("localhost", "[::1]")] == [200, 200]
        assert [codes[name] for name in ("evil.example:PORT", "127.0.0.1:1")] == [404, 404]
        assert "http://evil.example" not in codes
        assert "null" not in codes
        assert not re.findall(r'(?:src|href)="(?:https?:)?//', page)
        with socket.socket() as other, pytest.raises(ConnectionRefusedError):
            other.connect(("127.0.0.2", int(host.rpartition(":")[2])))
        process.send_signal(signal.SIGINT)
        out, said = process.communicate(timeout=60)
        assert process.returncode == 0
        assert out.splitlines()[-1] == "ringwear explore: ended"
        assert "Traceback" not in said
        assert "ringwear: stopped" not in said


def test_a_port_and_a_signal_while_nobody_looks():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        refused = ringwear("explore", PAPER, "--no-browser", "--port", port)
    assert refused.returncode == 2
    assert sentences(refused) == [
        f"ringwear: --port {port}: Address already in use; must be free, or absent for any that is"
    ]
    with served(PAPER, "--port", port) as (address, process):
        assert address.startswith(f"http://127.0.0.1:{port}/")
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0
        assert process.stderr.read() == ""


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["away.toml"], "away.toml: cannot be read: No such file or directory"),
        ([PAPER, "--port", "70000"], "--port: 70000: must be from 0 to 65535"),
        ([PAPER, "--set", "lower.young=-1"], "--set lower.young = -1: must be a finite number > 0"),
        ([CASES / "study.toml"], "is a study, not a case"),
    ],
)
def test_what_is_refused(words, said, tmp_path, capfd):
    def refused(command, *more):
        assert main([command, *map(str, words), *map(str, more)]) == 2
        return capfd.readouterr().err.splitlines()

    lines = refused("explore", "--no-browser")
    assert len(lines) == 1
    assert said in lines[0]
    if "--port" not in words:  # in the words of run
        assert lines == refused("run", "-o", tmp_path / "never.h5")


def test_ranks_and_a_missing_package_are_refused(monkeypatch, comm):
    from ringwear_par.explorer.server import explore

    with pytest.raises(rw.InputError, match="is started on 2 ranks; must be on one, without mpi"):
        explore(PAPER, [], comm=SimpleNamespace(size=2), browser=False)
    for name in [n for n in sys.modules if n.partition(".")[0] == "bokeh"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "bokeh", None)
    with pytest.raises(rw.InputError, match=r"pip install 'ringwear-par\[explore\]'"):
        explore(PAPER, [], comm=comm, browser=False)
