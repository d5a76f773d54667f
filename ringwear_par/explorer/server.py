"""The server of the page: on 127.0.0.1 only, under a random token; histories in the main thread."""

import asyncio
import logging
import os
import secrets
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from mpi4py import MPI

from ringwear_par.errors import InputError
from ringwear_par.explorer.exploring import Exploration
from ringwear_par.explorer.moved_keys import raw_keys
from ringwear_par.results.progress import StopSignals

log = logging.getLogger(__name__)

_HOST = "127.0.0.1"
#: names of this machine under which pages are answered
_NAMES = ("127.0.0.1", "localhost", "[::1]")
#: bytes of the token in the address
_TOKEN = 24
#: how long the server's thread may take to begin, and to end, s
_BEGIN, _END = 30.0, 2.0
#: how long the main thread waits at a time, s
_NAP = 0.2


def explore(
    path: Path,
    overrides: list[str],
    *,
    comm: MPI.Comm,
    port: int = 0,
    browser: bool = True,
) -> None:
    """Serve the page of a case until a signal ends it. On one rank.

    Parameters
    ----------
    path : case file.
    overrides : ``KEY=VALUE`` texts.
    port : 0 for any that is free.
    browser : whether the user's browser is opened.

    Raises
    ------
    InputError : a bad case, more ranks than one, a missing package, a port that is not free.
    """
    if comm.size > 1:
        raise InputError(
            f"explore: is started on {comm.size} ranks; must be on one, without mpirun, as one "
            "page computes one history at a time"
        )
    keys = raw_keys(path, overrides)
    try:
        import bokeh.server  # noqa: F401
    except ImportError as error:
        raise InputError(
            "explore: needs the Python package bokeh; pip install 'ringwear-par[pages]'"
        ) from error
    for name in ("bokeh", "tornado", "asyncio"):
        logging.getLogger(name).setLevel(logging.ERROR)
    listening = _listen(port)
    with listening, suppress(KeyboardInterrupt), StopSignals(at_once=True) as signals:
        exploration = Exploration(keys, str(path), comm)
        desk: SimpleQueue[Callable[[], None]] = SimpleQueue()
        server = _Server(exploration, path.name, listening, desk.put)
        server.start()
        try:
            print(f"{server.address}\nopen this in a browser on this machine; Ctrl-C ends it",
                  flush=True)  # fmt: skip
            if browser and _has_screen():
                opening = threading.Thread(target=webbrowser.open, args=(server.address,))
                opening.daemon = True
                opening.start()
            # MPI and PETSc are used by this thread alone; Ctrl-C is how it ends
            while not signals.received:  # which may only have made a history fail
                with suppress(Empty):  # not for ever: a signal just before does not end the wait
                    desk.get(timeout=_NAP)()
        finally:
            server.stop()
    print("ringwear explore: ended", flush=True)


def _listen(port: int) -> socket.socket:
    """Return a socket that listens on this machine alone.

    Raises
    ------
    InputError : the port cannot be had.
    """
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    # many small messages: none is to wait for the receipt of another
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    try:
        listening.bind((_HOST, port))
    except OSError as error:
        listening.close()
        raise InputError(
            f"--port {port}: {error.strerror}; must be free, or absent for any that is"
        ) from error
    listening.listen(128)
    listening.setblocking(False)
    return listening


def _has_screen() -> bool:
    """Tell whether a browser would have somewhere to open."""
    names = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
    return sys.platform == "darwin" or any(os.environ.get(name) for name in names)


class _Server(threading.Thread):
    """Bokeh's server in a thread of its own, so that a page answers while histories are computed.

    Parameters
    ----------
    exploration : of the case.
    title : of the page.
    listening : socket.
    put : gives the main thread something to do.
    """

    def __init__(
        self,
        exploration: Exploration,
        title: str,
        listening: socket.socket,
        put: Callable[[Callable[[], None]], None],
    ) -> None:
        super().__init__(name="server", daemon=True)
        port, token = listening.getsockname()[1], secrets.token_urlsafe(_TOKEN)
        self.address = f"http://{_HOST}:{port}/{token}/"
        self._exploration, self._title, self._listening, self._put = (
            exploration, title, listening, put,
        )  # fmt: skip
        self._token, self._hosts = token, [f"{_HOST}:{port}", f"localhost:{port}"]
        self._loop: Any = None
        self._begun = threading.Event()

    def start(self) -> None:
        """Start to serve; return once pages can be asked for."""
        super().start()
        if not self._begun.wait(_BEGIN):
            raise RuntimeError("the server has not begun")

    def run(self) -> None:
        """Serve until the loop is stopped."""
        from bokeh.application import Application
        from bokeh.application.handlers.function import FunctionHandler
        from bokeh.server.server import BaseServer
        from bokeh.server.tornado import BokehTornado
        from tornado.httpserver import HTTPServer
        from tornado.httputil import split_host_and_port
        from tornado.ioloop import IOLoop
        from tornado.routing import Matcher, Rule, RuleRouter

        from ringwear_par.explorer.page import Page

        asyncio.set_event_loop(asyncio.new_event_loop())
        self._loop = IOLoop.current()

        def add_page(document: Any) -> None:
            def later(callback: Callable[[], None]) -> None:
                self._loop.add_callback(_if_there, document, callback)

            Page(document, self._exploration, self._title, self._hosts, self._put, later)

        application = Application(FunctionHandler(add_page))
        tornado = BokehTornado(
            {"/": application}, prefix=self._token, extra_websocket_origins=self._hosts,
            use_index=False,
        )  # fmt: skip
        port = self._listening.getsockname()[1]

        class OwnHost(Matcher):
            """Lets pass what is asked of this machine, or others' names for it would read pages."""

            def match(self, request: Any) -> dict[str, Any] | None:
                name, number = split_host_and_port(request.host.lower())
                return {} if name in _NAMES and (number or 80) == port else None

        http = HTTPServer(RuleRouter([Rule(OwnHost(), tornado)]))
        http.add_sockets([self._listening])
        server = BaseServer(self._loop, tornado, http)
        server.start()
        self._loop.add_callback(self._begun.set)
        self._loop.start()

    def stop(self) -> None:
        """Stop serving."""
        if self._loop is not None:
            self._loop.add_callback(self._loop.stop)
            self.join(_END)


def _if_there(document: Any, callback: Callable[[], None]) -> None:
    """Call back with a document that may change, unless its page has been closed meanwhile."""
    if document.session_context is not None:
        document.add_next_tick_callback(callback)
