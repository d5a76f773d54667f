"""Headless Chromium, driven by its own protocol over tornado's web sockets."""

import asyncio
import base64
import itertools
import json
import shutil
import subprocess
import time
from contextlib import suppress

import pytest
from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
in_browser = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium: apt-get install chromium has the pages opened in one"
)
#: without a window, and where nothing but this machine is found
HEADLESS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)  # fmt: skip
#: s, limit for Chromium to start
_START = 60.0


class Browser:
    """A page in Chromium; a context manager.

    Parameters
    ----------
    profile : folder for its files.
    width, height : pixels of the page.
    """

    def __init__(self, profile, width=1280, height=900):
        self._loop = asyncio.new_event_loop()
        self._numbers = itertools.count(1)
        #: errors and warnings of its console, and addresses that it has asked for
        self.said, self.asked_for = [], []
        self._process = subprocess.Popen(
            [
                CHROMIUM, *HEADLESS, "--no-first-run", "--disable-extensions",
                "--disable-background-networking", f"--user-data-dir={profile}",
                f"--window-size={width},{height}", "--remote-debugging-port=0",
                "--remote-allow-origins=*", "about:blank",
            ],
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        port = self._port(profile / "DevToolsActivePort")
        self._socket = self._loop.run_until_complete(self._connect(f"127.0.0.1:{port}"))
        for domain in ("Page", "Runtime", "Log", "Network", "DOM"):
            self.call(f"{domain}.enable")
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height,
                  deviceScaleFactor=1, mobile=False)  # fmt: skip

    def _port(self, path):
        """Wait until Chromium has written where it listens."""
        until = time.monotonic() + _START
        while not (path.exists() and path.read_text().count("\n")):
            if self._process.poll() is not None or time.monotonic() > until:
                self._process.kill()
                raise RuntimeError("Chromium has not started")
            time.sleep(0.02)
        return path.read_text().partition("\n")[0]

    async def _connect(self, host):
        from tornado.httpclient import AsyncHTTPClient

        answer = await AsyncHTTPClient().fetch(f"http://{host}/json")
        page = next(p for p in json.loads(answer.body) if p["type"] == "page")
        return await websocket_connect(
            HTTPRequest(page["webSocketDebuggerUrl"]), max_message_size=2**28
        )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._loop.run_until_complete(self._disconnect())
        self._loop.close()
        self._process.kill()
        self._process.wait()

    async def _disconnect(self):
        self._socket.close()
        with suppress(asyncio.TimeoutError):
            while await asyncio.wait_for(self._socket.read_message(), 1.0) is not None:
                pass

    def call(self, method, **parameters):
        """Call a method of the protocol, and return what it answers."""
        number = next(self._numbers)
        message = json.dumps({"id": number, "method": method, "params": parameters})
        return self._loop.run_until_complete(self._answer(message, number))

    async def _answer(self, message, number):
        await self._socket.write_message(message)
        while True:
            text = await asyncio.wait_for(self._socket.read_message(), 60)
            told = json.loads(text)
            self._note(told)
            if told.get("id") == number:
                if "error" in told:
                    raise RuntimeError(told["error"]["message"])
                return told["result"]

    def _note(self, told):
        method, about = told.get("method"), told.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.said.append(str(about["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and about["type"] in ("error", "warning"):
            self.said.append(str([a.get("value", a.get("description")) for a in about["args"]]))
        elif method == "Log.entryAdded" and about["entry"]["level"] in ("error", "warning"):
            self.said.append(f"{about['entry']['text']} {about['entry'].get('url', '')}")
        elif method == "Network.requestWillBeSent":
            self.asked_for.append(about["request"]["url"])

    def open(self, address):
        """Open a page."""
        self.call("Page.navigate", url=address)
        self.wait(f"location.href === {json.dumps(address)} && document.readyState === 'complete'")

    def run(self, script):
        """Return what a script of JavaScript comes to."""
        done = self.call("Runtime.evaluate", expression=script, returnByValue=True,
                         awaitPromise=True)  # fmt: skip
        if "exceptionDetails" in done:
            raise RuntimeError(str(done["exceptionDetails"]))
        return done["result"].get("value")

    def wait(self, script, seconds=60.0):
        """Return what a script comes to as soon as it is true."""
        until = time.monotonic() + seconds
        while not (found := self.run(script)):
            if time.monotonic() > until:
                raise TimeoutError(f"{script}: never; the console said {self.said}")
            time.sleep(0.02)
        return found

    def key(self, name, code=0):
        """Press a key where the focus is."""
        for kind in ("rawKeyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=name, code=name,
                      windowsVirtualKeyCode=code)  # fmt: skip

    def choose_files(self, selector, *paths):
        """Choose files in an input of the page."""
        root = self.call("DOM.getDocument")["root"]["nodeId"]
        node = self.call("DOM.querySelector", nodeId=root, selector=selector)["nodeId"]
        self.call("DOM.setFileInputFiles", nodeId=node, files=[str(path) for path in paths])

    def picture(self, path, whole=True):
        """Save a picture of the page."""
        done = self.call("Page.captureScreenshot", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(done["data"]))
