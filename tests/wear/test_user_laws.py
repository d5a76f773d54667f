"""Laws of users: what they may not do, what becomes of a run if they do, slopes that they lack."""

from dataclasses import dataclass, replace

import h5py
import numpy as np
import pytest
from parts import Law, refuse_bad_laws, run_case, user
from paths import PAPER
from wearing import RunningInLaw, sliding

import ringwear_par as rw

GOOD = """
def rate(p, at): return 1e-8 * at.speed * p
def d_rate_dp(p, at): return 1e-8 * at.speed + 0 * p
"""
BASE = ["mesh.contact_elements=16", "time.scheme=adaptive", "time.end=20", "wear.lower.law=user"]
P, POWER = np.array([0.0, 10.0, 39.0, 41.0, 100.0]), np.array([1.0, 2.0, 3.0, 4.0, 5.0])


@pytest.fixture
def law(tmp_path, comm):
    """Function that writes a law's file and returns the overrides that name it."""
    path = tmp_path / "law.py"
    return lambda source: (path.write_text(source), [*BASE, f"wear.lower.file={path}"])[1]


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("raise SystemExit(0)", "SystemExit"),
        ("def d_rate_dp(p, at): return p", "define rate"),
        (GOOD.replace("* at.speed * p", "* p * (500 - p)"), "falls"),
        (GOOD.replace("* at.speed * p", "* p * (1 + 9 * (p > 79))"), r"jumps .* p = 79 MPa"),
    ],
)
def test_bad_files_are_refused_before_work(law, tmp_path, comm, source, words):
    with pytest.raises(rw.InputError, match=words):
        run_case(PAPER, tmp_path / "run.h5", law(source), comm=comm)
    assert not (tmp_path / "run.h5").exists()


class Mine:
    """A law as a user may write it, of one function."""

    def __init__(self, rate, **more):
        self.own_rate = rate
        vars(self).update(more)

    def rate(self, p, local):
        """Return the rate of wear, mm/s."""
        return self.own_rate(p, local)


def lowered_by_20(p, local):
    p -= 20.0
    return 1e-8 * local.speed * p


BAD_OBJECTS = {
    "read-only": Mine(lowered_by_20),
    "-3e-07": Mine(lambda p, local: 1e-8 * (p - 30)),
    "must be 0 without": Mine(lambda p, local: 1e-8 * (p + 30)),
    "velocity": Mine(lambda p, local: 1e-8 * p * local.velocity),
    "nan": Mine(lambda p, local: p * np.nan),
    "NoneType": Mine(lambda p, local: None),
    "falls": Mine(lambda p, local: 1e-11 * p * (500 - p)),
    "d_rate_dp.*>= 0": Mine(lambda p, local: 1e-8 * p, d_rate_dp=lambda p, local: -1e-8 + 0 * p),
    "function": lambda p, local: 1e-8 * p,
    "not a class": Mine,
    "float": 3.0,
    "length": Mine(lowered_by_20, length="a"),
    "breakpoints": Mine(lowered_by_20, breakpoints=3),
}


@pytest.mark.parametrize(("words", "bad"), BAD_OBJECTS.items(), ids=BAD_OBJECTS)
def test_bad_objects_are_refused_as_bad_files_are(bad, words):
    case = replace(rw.read_case(PAPER), wear_upper=bad)
    with pytest.raises(rw.InputError, match=rf"wear\.upper.*{words}"):
        refuse_bad_laws(case, "case")


def test_a_law_that_fails_during_work_is_an_error_with_time_and_element(law, tmp_path, comm):
    late = "import numpy as np\n" + GOOD.replace(
        "1e-8 * at.speed * p", "np.where(at.time > 5, -1.0, 1e-8 * at.speed * p)"
    )
    with pytest.raises(rw.ComputationError, match=r"-1.*time [\d.]+ s, element \d+"):
        run_case(PAPER, tmp_path / "run.h5", law(late), comm=comm)


def test_restart_wants_the_same_law(law, tmp_path, comm):
    output, keys = tmp_path / "run.h5", law(GOOD)
    run_case(PAPER, output, keys, comm=comm)
    law(GOOD.replace("1e-8", "3e-8"))
    with pytest.raises(rw.InputError, match="another wear law"):
        run_case(PAPER, output, [*keys, "time.end=40"], comm=comm, restart=True)
    law(GOOD)
    run_case(PAPER, output, [*keys, "time.end=40"], comm=comm, restart=True)


def test_wear_that_grows_too_fast_with_itself_is_an_error(law, tmp_path, comm):
    """Steps become smaller, within fixed ones too, until half of the body is gone."""
    growing = "def rate(p, at): return 1e-8 * at.speed * p * (1 + at.wear / 1e-3)"
    fixed = [k for k in law(growing) if not k.startswith("time")]
    for keys in ([*fixed, "time.step=50", "time.steps=2"], [*law(growing), "time.end=2000"]):
        with pytest.raises(rw.ComputationError, match="half of its height"):
            run_case(PAPER, tmp_path / "a.h5", keys, comm=comm)


def test_a_file_may_have_breakpoints(law, tmp_path, comm):
    """A pulse that one long step would pass over."""
    pulse = GOOD.replace("return 1e-8", "return (10 < at.time <= 100) * 1e-8")
    for source, wears in (
        (pulse, False),
        (pulse + "breakpoints = [10.0, 10.001, 100.0, 100.001]", True),
    ):
        output = tmp_path / f"{wears}.h5"
        run_case(PAPER, output, [*law(source), "time.end=2000"], comm=comm)
        with h5py.File(output) as file:
            assert (file["worn_volume_lower"][-1] > 1.0) == wears


def test_a_file_that_is_no_text_is_refused_with_all_other_faults(law, tmp_path):
    keys = [*law("\ufeff" + GOOD), "contact.friction=-1"]
    assert rw.read_case(PAPER, keys[:-1]).wear_lower.code.source == GOOD
    (tmp_path / "law.py").write_bytes(b"\xff\xfe")
    with pytest.raises(rw.InputError) as refused:
        rw.read_case(PAPER, keys)
    friction, file = refused.value.faults
    assert "contact.friction" in friction
    assert "UTF-8" in file


PLAIN = """
import numpy as np

def rate(p, at):
    k = at.parameters["k"] * (1.0 + np.exp(-at.wear / 0.01))
    return k * at.friction * at.speed * np.log1p(p / 50.0)
"""
EXACT = """
def d_rate_dp(p, at):
    k = at.parameters["k"] * (1.0 + np.exp(-at.wear / 0.01))
    return k * at.friction * at.speed / (50.0 + p)

def d_rate_dwear(p, at):
    k = -at.parameters["k"] * np.exp(-at.wear / 0.01) / 0.01
    return k * at.friction * at.speed * np.log1p(p / 50.0)
"""


def test_files_remember_wear_by_reading_it_and_need_no_derivatives(law):
    def read(source):
        return rw.read_case(PAPER, [*law(source), "wear.lower.parameters={k=1e-7}"]).wear_lower

    plain, exact = read(PLAIN), read(PLAIN + EXACT)
    assert (plain.remembers, exact.remembers, plain.linear) == (True, True, False)
    assert not read(PLAIN + "remembers = False\n").remembers
    assert not read(GOOD).remembers
    assert read(GOOD + "breakpoints = [2, 1]").breakpoints == (1.0, 2.0)
    assert plain.key == read(PLAIN).key != exact.key
    at = replace(sliding(POWER, wear=np.full(5, 1e-3)), parameters={"k": 1e-7})
    # slopes by differences of a step of 1e-6 are for solvers: results do not depend on them
    for own, found in zip(exact.code.values(P, at), plain.code.values(P, at), strict=True):
        assert found == pytest.approx(own, rel=1e-6)


@dataclass(frozen=True)
class Hardening:
    """A law as a user may write it: nothing but a rate."""

    k: float
    depth: float

    def rate(self, p, local):
        """Return the rate of wear, mm/s."""
        if local.time > 5.0:
            raise ValueError("too late")
        return self.k * np.exp(-local.wear / self.depth) * local.power * p


def test_the_law_that_fails_is_named_beside_one_that_does_not(comm):
    case, bad = rw.read_case(PAPER, {"mesh.contact_elements": 12}), Hardening(1e-9, 1e-3)
    case = replace(case, wear_lower=bad, wear_upper=Mine(lambda p, local: 1e-11 * p))
    with pytest.raises(rw.ComputationError, match=r"Hardening.*too late"):
        rw.simulate(case, comm)


def test_histories_of_a_block_fail_one_by_one():
    """Their numbers are NaN, with a reason; the others are as those of running in."""
    law, n = Law.of(Hardening(9e-7, 1e-6)), 3
    wear, speed = np.full((n, 5), 1e-7), np.tile(POWER, (n, 1))
    at = rw.LocalState(
        np.array([[0.0], [7.0], [1.0]]), np.arange(1.0, 6.0), speed, np.ones((n, 1)), wear,
        0.0 * speed, number=np.array([[4], [8], [9]]),
    )  # fmt: skip
    p = np.array([P, P, P - 5.0])
    faults = {9: "no more"}
    arguments = {name: np.full((n, 1), q) for name, q in law.arguments.items()}
    values = user(law.code, faults, p, at, **arguments)
    known = RunningInLaw(0.0, 9e-7, depth=1e-6)
    for found, exact in zip(values, known.kind.function(p, at, **known.arguments), strict=True):
        assert found[0] == pytest.approx(exact[0], rel=1e-6)  # by differences
        assert np.isnan(found[1]).all()
        assert found[2, 1:] == pytest.approx(exact[2, 1:], rel=1e-6)
    assert faults == {8: "Hardening: rate() failed at time 7 s: ValueError: too late"}
    with pytest.raises(rw.ComputationError, match="too late"):
        law.rate(P, sliding(POWER, time=7.0))


def test_an_object_may_say_more():
    law = Law.of(Mine(lambda p, local: 1e-8 * p, remembers=False, breakpoints=(3.0, 1), length=0.5))
    assert (law.length, law.remembers, law.breakpoints) == (0.5, False, (1.0, 3.0))
    assert Law.of(law) is law
