"""The explorer's server: who gets the page, ports, signals, and what is refused."""

import asyncio
import re
import signal
import socket
from contextlib import suppress
from types import SimpleNamespace

import pytest
from commands import ringwear, sentences
from explorer_server import served
from paths import PAPER
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

import ringwear_par as rw
from ringwear_par.explorer.server import explore

SMALL = ["mesh.contact_elements=12", "time.steps=8"]


async def _answers(address):
    client, codes = AsyncHTTPClient(), {}
    host, token = re.fullmatch(r"http://([^/]+)/([^/]+)/", address).groups()
    port = host.rpartition(":")[2]
    for prefix in ("", f"{token[:-1]}/"):
        for name in ("", "ws", "autoload.js", "static/js/bokeh.min.js"):
            done = await client.fetch(f"http://{host}/{prefix}{name}", raise_error=False)
            codes[prefix + name] = done.code
    for name in (f"localhost:{port}", f"evil.example:{port}"):
        done = await client.fetch(address, headers={"Host": name}, raise_error=False)
        codes[name.partition(":")[0]] = done.code
    page = (await client.fetch(address)).body.decode()
    found = re.search(r'"token":"([^"]+)"', page)[1]
    for origin in (f"http://{host}", "http://evil.example", "null"):
        asked = HTTPRequest(f"ws://{host}/{token}/ws", headers={"Origin": origin})
        with suppress(HTTPClientError):
            socket = await websocket_connect(asked, subprotocols=["bokeh", found])
            codes[origin] = (await asyncio.wait_for(socket.read_message(), 20)) is not None
            socket.close()
    return token, host, codes, page


def test_nothing_is_served_without_the_token():
    with served(PAPER, "--set", *SMALL) as (address, process):
        token, host, codes, page = asyncio.run(_answers(address))
        assert len(token) >= 32
        assert (codes.pop("localhost"), codes.pop(f"http://{host}")) == (200, True)
        assert len(codes) == 9  # and no answer to other origins
        assert set(codes.values()) == {404}
        assert not re.findall(r'(?:src|href)="(?:https?:)?//', page)
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
        assert address.startswith(f"http://127.0.0.1:{port}/")
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0
        assert process.stderr.read() == ""


def test_several_ranks_are_refused():
    with pytest.raises(rw.InputError, match="2 ranks"):
        explore(PAPER, [], comm=SimpleNamespace(size=2), browser=False)
