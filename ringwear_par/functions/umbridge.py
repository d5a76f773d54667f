"""``ringwear serve``: numbers of histories for programs that speak UM-Bridge 1.0, over HTTP.

Seelinger et al. 2023, UM-Bridge: Uncertainty quantification and modeling bridge, J. Open Source
Softw. 8, 4748. The model "forward" has one vector of inputs and one of outputs.
"""

import json
import logging
import math
import re
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, NoReturn

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.files.reading import read_case
from ringwear_par.cases.values import is_number
from ringwear_par.errors import InputError, RingwearError, legible, reason_of
from ringwear_par.files.text import shortened
from ringwear_par.functions.function import Function, function
from ringwear_par.results.execution.stop_signals import StopAtOnce, Stopped

log = logging.getLogger(__name__)

HOST, MODEL, _VERSION = "127.0.0.1", "forward", 1.0
#: names of this machine under which programs may call the server
_NAMES = ("127.0.0.1", "localhost")
#: bytes of a request, and cases of a batch
_LARGEST, _MOST = 2**20, 1024
#: s: how long the first of a batch waits for others, a program may take to send a request, and the
#: main thread waits before it looks for signals
_GATHER, _PATIENCE, _NAP = 0.005, 30.0, 0.2
#: what can be computed, and the vector that a request for it holds
_VECTORS = {"Evaluate": "", "Gradient": "sens", "ApplyJacobian": "vec"}


class RefusedError(Exception):
    """A request that is answered with an error of UM-Bridge: its type, a sentence, a status."""

    def __init__(self, kind: str, sentence: str, status: int = 400) -> None:
        super().__init__(sentence)
        self.kind, self.status = kind, status


@dataclass(frozen=True)
class Request:
    """A point that is to be computed."""

    #: (inputs,) float
    point: Sequence[float]
    #: one of ``_VECTORS``
    task: str
    #: (outputs,) of a gradient, (inputs,) of a Jacobian
    vector: Sequence[float]
    #: list of numbers, or an error, once the batch is computed
    answer: "Future[list[float]]" = field(default_factory=Future)


class Model:
    """The numbers of a case's histories as UM-Bridge asks for them.

    Parameters
    ----------
    values : function of the inputs.
    slopes : the same with derivatives; None where there are none.
    """

    def __init__(self, values: Function, slopes: Function | None) -> None:
        self._values, self._slopes = values, slopes
        self.inputs, self.outputs = (list(values.schema[part]) for part in ("inputs", "outputs"))
        #: points that wait for the main thread
        self.waiting: SimpleQueue[Request] = SimpleQueue()

    def answer(self, route: str, body: Mapping[str, Any]) -> dict[str, Any]:
        """Return the answer to a request. In a thread of the server.

        Raises
        ------
        RefusedError : it is none that can be answered.
        """
        if route == "Info":
            return {"protocolVersion": _VERSION, "models": [MODEL]}
        known = ("InputSizes", "OutputSizes", "ModelInfo", "ApplyHessian", *_VECTORS)
        if route not in known:
            _refuse(f"{legible(route)}: must be one of Info, {', '.join(known)}", 404)
        if body.get("name") != MODEL:
            name = shortened(body.get("name"))
            raise RefusedError("ModelNotFound", f'name = {name}: must be "{MODEL}"')
        if route == "InputSizes":
            return {"inputSizes": [len(self.inputs)]}
        if route == "OutputSizes":
            return {"outputSizes": [len(self.outputs)]}
        support = {
            task: not vector or self._slopes is not None for task, vector in _VECTORS.items()
        }
        support["ApplyHessian"] = False
        if route == "ModelInfo":
            return {"support": support}
        if not support[route]:
            raise RefusedError("UnsupportedFeature", f"{route}: this model has no such derivatives")
        request = self._request(route, body)
        self.waiting.put(request)
        answer = request.answer.result()
        return {"output": [answer] if route == "Evaluate" else answer}

    def _request(self, task: str, body: Mapping[str, Any]) -> Request:
        if body.get("config"):
            _refuse(f"config = {shortened(body['config'])}: must be empty")
        points = body.get("input")
        if not isinstance(points, list) or len(points) != 1:
            _refuse(f"input = {shortened(points)}: must be a list of one vector")
        point, name = _vector("input[0]", points[0], self.inputs), _VECTORS[task]
        if not name:
            return Request(point, task, ())
        for which in ("outWrt", "inWrt"):
            if body.get(which) != 0:
                _refuse(f"{which} = {shortened(body.get(which))}: must be 0")
        names = self.outputs if task == "Gradient" else self.inputs
        return Request(point, task, _vector(name, body.get(name), names))

    def compute(self) -> None:
        """Wait a little for a request, gather others, and answer them. In the main thread."""
        batch: list[Request] = []
        with suppress(Empty):
            # not for ever: a signal just before does not end the wait
            batch.append(self.waiting.get(timeout=_NAP))
            end = time.monotonic() + _GATHER
            while len(batch) < _MOST:
                batch.append(self.waiting.get(timeout=max(end - time.monotonic(), 0.0)))
        for task in ("Evaluate", ""):
            part = [request for request in batch if (request.task == "Evaluate") is bool(task)]
            compute = self._values if task else self._slopes
            if part and compute is not None:
                self._answer(part, compute)

    def _answer(self, batch: Sequence[Request], compute: Function) -> None:
        points = zip(*(request.point for request in batch), strict=True)
        try:
            outcome = compute(dict(zip(self.inputs, points, strict=True)), MPI.COMM_SELF)
        except Exception as error:  # the server goes on; the terminal has the traceback
            log.exception("a batch failed unexpectedly")
            for request in batch:
                request.answer.set_exception(_error(error))
            return
        for n, request in enumerate(batch):
            if n in compute.errors:
                request.answer.set_exception(_error(compute.errors[n]))
            else:
                request.answer.set_result(self._numbers(request, outcome, n).tolist())

    def _numbers(self, request: Request, outcome: Any, n: int) -> FloatArray:
        """Return the numbers of the answer to a request, of the outcome of its batch."""
        if request.task == "Evaluate":
            return np.array([outcome[name][n] for name in self.outputs])
        slopes = np.array([[outcome[1][o, i][n] for i in self.inputs] for o in self.outputs])
        vector = np.array(request.vector)
        return vector @ slopes if request.task == "Gradient" else slopes @ vector


def _error(error: Exception) -> RefusedError:
    """Return the error of UM-Bridge for a case that failed."""
    if isinstance(error, InputError):
        return RefusedError("InvalidInput", str(error))
    words = str(error) if isinstance(error, RingwearError) else reason_of(error)
    return RefusedError("InvalidOutput", words, 500)


def _refuse(sentence: str, status: int = 400) -> NoReturn:
    raise RefusedError("InvalidInput", sentence, status)


def _vector(name: str, values: Any, names: Sequence[str]) -> list[float]:
    if (
        not isinstance(values, list)
        or len(values) != len(names)
        or not all(is_number(value) and math.isfinite(value) for value in values)
    ):
        count = "1 number" if len(names) == 1 else f"{len(names)} numbers"
        _refuse(f"{name} = {shortened(values)}: must be {count}: {', '.join(names)}")
    return values


class _Handler(BaseHTTPRequestHandler):
    """Answers one program. All answers are JSON, errors too."""

    protocol_version, timeout = "HTTP/1.1", _PATIENCE
    server: "_Server"

    def do_GET(self) -> None:
        self._reply()

    do_POST = do_GET  # noqa: N815

    def _reply(self) -> None:
        try:
            self._check_sender()
            self._send(200, self.server.model.answer(self.path.strip("/"), self._body()))
        except RefusedError as refused:
            self._send(refused.status, _error_json(refused.kind, str(refused)))
        except RecursionError:
            self._send(400, _error_json("InvalidInput", "is nested too deeply"))

    def _check_sender(self) -> None:
        """Refuse what is asked by a page of the browser, or of another name than this machine's."""
        host = self.headers.get("Host", "").rpartition(":")[0] or self.headers.get("Host", "")
        if host.lower() not in _NAMES or "Origin" in self.headers:
            self.close_connection = True
            _refuse("must be asked by a program on this machine, as 127.0.0.1 or localhost", 403)

    def _body(self) -> Mapping[str, Any]:
        """Return the object of a request, {} for none."""
        length = self.headers.get("Content-Length", "0")
        in_parts = "Transfer-Encoding" in self.headers
        if in_parts or not (re.fullmatch("[0-9]{1,9}", length) and int(length) <= _LARGEST):
            self.close_connection = True
            _refuse(f"Content-Length = {legible(length)}: must be there, at most {_LARGEST} bytes")
        try:
            body = json.loads(self.rfile.read(int(length)) or "{}")
        except ValueError as error:
            _refuse(f"is no JSON: {legible(str(error))}")
        if not isinstance(body, dict):
            _refuse(f"{shortened(body)}: must be an object")
        return body

    def _send(self, status: int, answer: Mapping[str, Any]) -> None:
        text = json.dumps(answer).encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(text)))
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(text)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Answer what is no request of UM-Bridge at all."""
        self.close_connection = True
        self.command = self.command or ""
        self._send(400, _error_json("InvalidInput", legible(message or f"HTTP error {code}")))

    def log_message(self, format: str, *arguments: Any) -> None:
        log.debug(format, *arguments)


def _error_json(kind: str, sentence: str) -> dict[str, Any]:
    return {"error": {"type": kind, "message": sentence}}


class _Server(ThreadingHTTPServer):
    """A thread for each program that is connected; on this machine alone."""

    daemon_threads, request_queue_size = True, 128

    def __init__(self, port: int, model: Model) -> None:
        self.model = model
        super().__init__((HOST, port), _Handler)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Note a program that has gone."""
        log.debug("a connection failed", exc_info=True)


def serve(
    path: Path,
    overrides: list[str],
    *,
    inputs: list[str],
    outputs: list[str],
    comm: MPI.Comm,
    port: int = 4242,
) -> None:
    """Answer programs that speak UM-Bridge until a signal ends it. On one rank.

    Parameters
    ----------
    path : case file.
    overrides : ``KEY=VALUE`` texts.
    inputs, outputs : as of ``rw.function``, but for outputs at all states.
    port : 0 for any that is free.

    Raises
    ------
    InputError : a bad case, inputs or outputs, more ranks than one, a port that is not free.
    """
    if comm.size > 1:
        raise InputError(
            f"serve: is started on {comm.size} ranks; must be on one, without mpirun, as requests "
            "are one batch"
        )
    if whole := [output for output in outputs if output.endswith("@all")]:
        raise InputError(f"--outputs: {legible(whole[0])}: must be NAME or NAME@t")
    case = read_case(path, overrides)
    try:
        values = function(case, inputs, outputs)
    except InputError as error:
        raise InputError(*(f.replace("function: ", "--", 1) for f in error.faults)) from error
    slopes, gradients = None, "yes"
    try:
        slopes = function(case, inputs, outputs, derivatives=True)
    except InputError as error:
        gradients = f"no: {error.faults[0]}"
    model = Model(values, slopes)
    try:
        server = _Server(port, model)
    except OSError as error:
        raise InputError(
            f"--port {port}: {error.strerror}; must be free, or 0 for any that is"
        ) from error
    with server, suppress(Stopped), StopAtOnce() as signals:  # Ctrl-C is how it ends
        Thread(target=server.serve_forever, daemon=True).start()
        for part, schema in values.schema.items():
            units = (f"{name} ({entry['unit']})" for name, entry in schema.items())
            print(f"{part}: {', '.join(units)}")
        print(f"gradients: {gradients}")
        print(
            f'http://{HOST}:{server.server_address[1]}: UM-Bridge 1.0, model "{MODEL}", for all '
            "programs on this machine, without a password; Ctrl-C ends it", flush=True,
        )  # fmt: skip
        while True:  # MPI, PETSc and compiled code are used by this thread alone
            model.compute()
            signals.check()
    print("ringwear serve: ended", flush=True)
