"""``ringwear explore``: the server of the page, on this machine only, under a random token."""

import logging
import secrets
import threading
import webbrowser
from contextlib import suppress
from pathlib import Path

from mpi4py import MPI

from ringwear_par.cases.files.reading import read_case
from ringwear_par.errors import InputError
from ringwear_par.history.refusals import check_case
from ringwear_par.results.progress import StopSignals

#: bytes of the token in the address
_TOKEN = 24


def explore(
    path: Path, overrides: list[str], *, comm: MPI.Comm, port: int = 0, browser: bool = True
) -> None:
    """Serve the page of a case on this machine until a signal ends it. On one rank.

    Parameters
    ----------
    path : case file.
    overrides : ``KEY=VALUE`` texts.
    port : 0 for any that is free.
    browser : whether the user's browser is opened.

    Raises
    ------
    InputError : a bad case, more ranks than one, a missing package, a port that is not free.
    ComputationError : the history of the case fails.
    """
    if comm.size > 1:
        raise InputError(
            f"explore: is started on {comm.size} ranks; must be on one, without mpirun, as one "
            "page computes one history at a time"
        )
    case = read_case(path, overrides)
    check_case(case, 1, str(path))
    try:
        from bokeh.server.server import Server

        from ringwear_par.explorer.page import Explorer, history_of
    except ImportError as error:
        raise InputError(
            "explore: needs the Python package bokeh; pip install 'ringwear-par[explore]'"
        ) from error
    for name in ("bokeh", "tornado", "asyncio"):
        logging.getLogger(name).setLevel(logging.ERROR)
    token, result = secrets.token_urlsafe(_TOKEN), history_of(case, comm)
    try:
        server = Server(
            {"/": lambda document: Explorer(case, result, path.name, comm).open(document)},
            port=port, address="127.0.0.1", prefix=token, use_index=False,
        )  # fmt: skip
    except OSError as error:
        raise InputError(
            f"--port {port}: {error.strerror}; must be free, or absent for any that is"
        ) from error
    address = f"http://localhost:{server.port}/{token}/"
    with suppress(KeyboardInterrupt), StopSignals(at_once=True):
        print(f"{address}\nopen this in a browser on this machine; Ctrl-C ends it", flush=True)
        if browser:
            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
        server.run_until_shutdown()
