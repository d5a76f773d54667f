"""The server that speaks UM-Bridge: numbers of the function, batches, and errors that it words."""

import http.client
import json
import signal
import socket
import subprocess
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from threading import Thread
from types import SimpleNamespace

import numpy as np
import pytest
from commands import RINGWEAR, SHELL_ENVIRONMENT
from paths import PAPER

import ringwear_par as rw
from ringwear_par.cli import main
from ringwear_par.functions.umbridge import MODEL, Model, RefusedError, _Server

pytestmark = pytest.mark.serial
SMALL = {"mesh.contact_elements": 12, "time.steps": 20}
KEYS, NAMES = ["wear.lower.k", "load.pressure"], ["penetration", "torque"]
POINT = [2e-7, 60.0]


class Counted:
    """A function that counts its calls."""

    def __init__(self, function):
        self._function, self.calls = function, 0

    def __getattr__(self, name):
        return getattr(self._function, name)

    def __call__(self, *arguments):  # noqa: D102
        self.calls += 1
        return self._function(*arguments)


@pytest.fixture(scope="module")
def functions():
    case = rw.read_case(PAPER, SMALL)
    return [rw.function(case, KEYS, NAMES, derivatives=d) for d in (False, True)]


@contextmanager
def served(values, slopes):
    """The port of a server, and its model."""
    model = Model(values, slopes)
    with _Server(0, model) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield server.server_address[1], model
        server.shutdown()


def ask(port, route, body, **headers):
    """Return the status and the answer to a request: tables, or the text itself."""
    text = body if isinstance(body, str) else json.dumps(body)
    with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=60)) as connection:
        connection.request("GET" if route == "Info" else "POST", f"/{route}", text, headers)
        answer = connection.getresponse()
        return answer.status, json.loads(answer.read())


def test_numbers_of_the_function_in_batches(functions):
    values, slopes = map(Counted, functions)
    k = np.linspace(1e-7, 3e-7, 24).tolist()
    bodies = [("Evaluate", {"input": [[number, 60.0]]}) for number in k]
    products = {"outWrt": 0, "inWrt": 0, "input": [POINT]}
    bodies += [("Gradient", {**products, "sens": [1.0, 1e-6]})]
    bodies += [("ApplyJacobian", {**products, "vec": [1e-8, -3.0]})]
    bodies += [("Evaluate", {"input": [[-1e-7, 60.0]]})]
    with served(values, slopes) as (port, model), ThreadPoolExecutor(len(bodies)) as threads:
        requests = [threads.submit(ask, port, r, {"name": MODEL, **b}) for r, b in bodies]
        while not all(request.done() for request in requests):
            if not model.waiting.empty():
                model.compute()
    *answers, (status, failed) = (request.result() for request in requests)
    assert {status for status, _ in answers} == {200}
    expected = functions[0]({"wear.lower.k": k, "load.pressure": 60.0})
    numbers = [answer["output"][0] for _, answer in answers[:-2]]
    assert (np.transpose([expected[name] for name in NAMES]) == numbers).all()
    table = functions[1](dict(zip(KEYS, POINT, strict=True)))[1]
    jacobian = np.array([[table[name, key] for key in KEYS] for name in NAMES])
    gradient, product = (np.array(answer["output"]) for _, answer in answers[-2:])
    assert gradient == pytest.approx(np.array([1.0, 1e-6]) @ jacobian, rel=1e-12)
    assert product == pytest.approx(jacobian @ [1e-8, -3.0], rel=1e-12)
    assert status == 400
    assert failed["error"]["type"] == "InvalidInput"
    assert "wear.lower.k = -1e-07: must be" in failed["error"]["message"]
    assert values.calls + slopes.calls < len(bodies) / 2


def test_what_it_is_and_what_is_wrong(functions):
    good = {"name": MODEL, "input": [POINT]}
    with served(functions[0], None) as (port, _):
        assert ask(port, "Info", "") == (200, {"protocolVersion": 1.0, "models": [MODEL]})
        assert ask(port, "InputSizes", good) == (200, {"inputSizes": [2]})
        assert ask(port, "OutputSizes", good) == (200, {"outputSizes": [2]})
        support = ask(port, "ModelInfo", good)[1]["support"]
        assert [task for task, known in support.items() if known] == ["Evaluate"]
        for route, body, headers, status, kind in (
            ("Evaluate", {**good, "name": "wrong"}, {}, 400, "ModelNotFound"),
            ("Gradient", good, {}, 400, "UnsupportedFeature"),
            ("ApplyHessian", good, {}, 400, "UnsupportedFeature"),
            ("Nothing", good, {}, 404, "InvalidInput"),
            ("Evaluate", {**good, "input": [[1e-7]]}, {}, 400, "InvalidInput"),
            ("Evaluate", {**good, "input": [POINT, POINT]}, {}, 400, "InvalidInput"),
            ("Evaluate", {**good, "input": [[1e-7, "60"]]}, {}, 400, "InvalidInput"),
            ("Evaluate", {**good, "config": {"k": 1}}, {}, 400, "InvalidInput"),
            ("Evaluate", '{"name": "forward", "input": [[NaN, 1e999]]}', {}, 400, "InvalidInput"),
            ("Evaluate", "{", {}, 400, "InvalidInput"),
            ("Evaluate", "[" * 100000, {}, 400, "InvalidInput"),
            (
                "Evaluate",
                f'{{"name": "forward", "input": {"[" * 900}{"]" * 900}}}',
                {},
                400,
                "InvalidInput",
            ),
            ("Evaluate", "[1]", {}, 400, "InvalidInput"),
            ("Evaluate", "", {"Content-Length": "99999999"}, 400, "InvalidInput"),
            ("Evaluate", "0\r\n\r\n", {"Transfer-Encoding": "chunked"}, 400, "InvalidInput"),
            ("Evaluate", good, {"Host": "evil.example"}, 403, "InvalidInput"),
            ("Evaluate", good, {"Origin": "http://evil.example"}, 403, "InvalidInput"),
        ):
            answer = ask(port, route, body, **headers)
            assert (answer[0], answer[1]["error"]["type"]) == (status, kind), (route, body)
        with socket.create_connection(("127.0.0.1", port)) as connection:
            connection.sendall(b"BREW / HTTP/1.1\r\n\r\n")
            assert connection.recv(100).startswith(b"HTTP/1.1 400 ")
        with socket.socket() as other, pytest.raises(ConnectionRefusedError):
            other.connect(("127.0.0.2", port))


def test_one_number_is_called_so():
    function = SimpleNamespace(schema={"inputs": ["k"], "outputs": ["torque"]})
    with pytest.raises(RefusedError, match="must be 1 number: k"):
        Model(function, None).answer("Evaluate", {"name": MODEL, "input": [[]]})


def test_the_command(functions):
    umbridge = pytest.importorskip("umbridge")
    words = [*RINGWEAR, "serve", str(PAPER), "--set", *(f"{k}={v}" for k, v in SMALL.items())]
    words += ["--inputs", *KEYS, "--outputs", *NAMES, "--port", "0"]
    with subprocess.Popen(
        words, env=SHELL_ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            lines = [process.stdout.readline() for _ in range(4)]
            assert lines[0] == "inputs: wear.lower.k (1/MPa), load.pressure (MPa)\n"
            model = umbridge.HTTPModel(lines[3].partition(": UM-Bridge")[0], MODEL)
            expected = functions[0](dict(zip(KEYS, POINT, strict=True)))
            assert model([POINT]) == [[expected[name] for name in NAMES]]
            process.send_signal(signal.SIGINT)
            out, errors = process.communicate(timeout=60)
        finally:
            process.kill()
    assert (process.returncode, out, errors) == (0, "ringwear serve: ended\n", "")


def test_bad_words_of_the_command(capsys):
    for words, sentence in (
        (["torque@all"], "--outputs: torque@all: must be NAME or NAME@t"),
        (["torque@x"], "--outputs: torque@x: behind @ must be all"),
    ):
        assert main(["serve", str(PAPER), "--inputs", KEYS[0], "--outputs", *words]) == 2
        assert capsys.readouterr().err.startswith(f"ringwear: {sentence}")
