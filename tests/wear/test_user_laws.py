"""Laws from a user's file: what they may not do, and what becomes of a run if they do."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from parts import run_case
from paths import PAPER

import ringwear_par as rw
from ringwear_par import simulate
from ringwear_par.wear.laws.archard import ArchardLaw
from ringwear_par.wear.laws.running_in import RunningInLaw

GOOD = """
def rate(p, at): return 1e-8 * at.speed * p
def d_rate_dp(p, at): return 1e-8 * at.speed + 0 * p
"""
#: three times the rate of good
TRIPLE = GOOD.replace("1e-8", "3e-8")
BASE = ["mesh.contact_elements=16", "time.scheme=adaptive", "time.end=20", "wear.lower.law=user"]


@pytest.fixture
def law(tmp_path, comm):
    """Function that writes a law's file and returns the overrides that name it."""

    def law(source, name="law.py"):
        path = tmp_path / name
        path.write_text(source)
        return [*BASE, f"wear.lower.file={path}"]

    return law


@pytest.mark.parametrize(
    ("source", "words"),
    [
        (GOOD.replace("def rate(p, at): return", "def rate(p, at):\n  p -= 20.0\n  return"),
         "read-only"),
        ("raise SystemExit(0)", "SystemExit"),
        ("def d_rate_dp(p, at): return p", "define rate"),
        (GOOD.replace("* at.speed * p", "* p * (500 - p)"), "falls"),
    ],
)  # fmt: skip
def test_bad_laws_are_refused_before_work(law, tmp_path, comm, source, words):
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


class Falling(ArchardLaw):
    """A law of ours with another rate."""

    def rate(self, p, local):
        """Return the rate of wear, mm/s, which falls."""
        return 1e-11 * p * (500 - p)


BAD_OBJECTS = {
    "read-only": Mine(lowered_by_20),
    "-3e-07": Mine(lambda p, local: 1e-8 * (p - 30)),
    "velocity": Mine(lambda p, local: 1e-8 * p * local.velocity),
    "nan": Mine(lambda p, local: p * np.nan),
    "NoneType": Mine(lambda p, local: None),
    "falls": Falling(1e-8),
    "jumps": Mine(lambda p, local: 1e-8 * (p > 35)),
    "not the derivative": Mine(lambda p, local: 1e-8 * p, d_rate_dp=lambda p, local: 2e-8 + 0 * p),
    "not fall": Mine(lambda p, local: 1e-8 * p, d_rate_dp=lambda p, local: -1e-8 + 0 * p),
    "function": lambda p, local: 1e-8 * p,
    "is a class": Mine,
    "float": 3.0,
    "length": Mine(lowered_by_20, length="a"),
    "breakpoints": Mine(lowered_by_20, breakpoints=3),
}


@pytest.mark.parametrize(("words", "bad"), BAD_OBJECTS.items(), ids=BAD_OBJECTS)
def test_bad_objects_are_refused_as_bad_files_are(law, comm, bad, words):
    case = replace(rw.read_case(PAPER, law(GOOD)), wear_upper=bad)
    with pytest.raises(rw.InputError, match=rf"wear\.upper.*{words}"):
        simulate(case, comm)


def test_a_law_that_fails_during_work_is_an_error_with_time_and_element(law, tmp_path, comm):
    late = "import numpy as np\n" + GOOD.replace(
        "1e-8 * at.speed * p", "np.where(at.time > 5, -1.0, 1e-8 * at.speed * p)"
    )
    with pytest.raises(rw.ComputationError, match=r"-1.*time [\d.]+ s, element \d+"):
        run_case(PAPER, tmp_path / "run.h5", law(late), comm=comm)


def test_restart_wants_the_same_law(law, tmp_path, comm):
    output, keys = tmp_path / "run.h5", law(GOOD)
    run_case(PAPER, output, keys, comm=comm)
    law(TRIPLE)
    with pytest.raises(rw.InputError, match="another wear law"):
        run_case(PAPER, output, [*keys, "time.end=40"], comm=comm, restart=True)
    law(GOOD)
    run_case(PAPER, output, [*keys, "time.end=40"], comm=comm, restart=True)


def test_wear_that_grows_too_fast_with_itself_is_an_error(law, tmp_path, comm):
    """Fixed steps say so; adaptive ones become smaller until half of the body is gone."""
    growing = """
def rate(p, at): return 1e-8 * at.speed * p * (1 + at.wear / 1e-3)
def d_rate_dp(p, at): return 1e-8 * at.speed * (1 + at.wear / 1e-3) + 0 * p
def d_rate_dwear(p, at): return 1e-8 * at.speed * p / 1e-3
"""
    fixed = [k for k in law(growing) if not k.startswith("time")]
    fixed += ["time.scheme=implicit", "time.step=50", "time.steps=2"]
    with pytest.raises(rw.ComputationError, match="too fast"):
        run_case(PAPER, tmp_path / "a.h5", fixed, comm=comm)
    with pytest.raises(rw.ComputationError, match="half of its height"):
        run_case(PAPER, tmp_path / "a.h5", [*law(growing), "time.end=2000"], comm=comm)


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


def test_a_slope_with_kinks_is_no_wrong_one(law, tmp_path, comm):
    kinked = """
import numpy as np
P = np.linspace(0.0, 1000.0, 3000)
def rate(p, at): return 1e-11 * np.interp(p, P, P**2)
def d_rate_dp(p, at): return 1e-11 * np.diff(P**2)[np.searchsorted(P[1:], p)] / P[1]
"""
    run_case(PAPER, tmp_path / "a.h5", law(kinked), comm=comm)
    with pytest.raises(rw.InputError, match=r"d_rate_dp\(\) is not the derivative"):
        run_case(PAPER, tmp_path / "a.h5", law(kinked.replace("/ P[1]", "/ 0.33")), comm=comm)


def test_a_law_that_overrides_the_rate_of_another_wears_at_its_own(comm):
    """Its derivatives too, but not the closed form of the depth of a step."""

    class ThreeTimes(RunningInLaw):
        def rate(self, p, local):
            return 3.0 * super().rate(p, local)

        def d_rate_dp(self, p, local):
            return 3.0 * super().d_rate_dp(p, local)

        def d_rate_dwear(self, p, local):
            return 3.0 * super().d_rate_dwear(p, local)

        def potential(self, p, local):
            return 3.0 * super().potential(p, local)

    case = rw.read_case(PAPER, {"mesh.contact_elements": 12, "time.steps": 6})
    known, derived = (
        simulate(replace(case, wear_lower=law), comm=comm).histories["worn_volume_lower"]
        for law in (RunningInLaw(3e-7, 9e-7, depth=1e-4), ThreeTimes(1e-7, 3e-7, depth=1e-4))
    )
    assert derived == pytest.approx(known, rel=1e-9)


def test_energy_of_schedules(tmp_path, comm):
    """Force and speed grow in proportion to time, and nothing wears."""
    keys = ["mesh.contact_elements=16", "time.scheme=adaptive", "time.end=100", "wear.lower.k=0",
            "load.omega=[[0, 0], [100, 1]]", "load.pressure=[[0, 0], [100, 80]]"]  # fmt: skip
    run_case(PAPER, tmp_path / "run.h5", keys, comm=comm)
    with h5py.File(tmp_path / "run.h5") as file:
        exact = file["torque"][-1] * 100.0 / 3.0
        assert file["dissipated_energy"][-1] == pytest.approx(exact, rel=1e-3)
        assert len(file["time"]) < 60


def test_a_file_that_is_no_text_is_refused_with_all_other_faults(law, tmp_path):
    keys = [*law("\ufeff" + GOOD), "contact.friction=-1"]
    assert rw.read_case(PAPER, keys[:-1]).wear_lower.source == GOOD
    (tmp_path / "law.py").write_bytes(b"\xff\xfe")
    with pytest.raises(rw.InputError) as refused:
        rw.read_case(PAPER, keys)
    friction, file = refused.value.faults
    assert "contact.friction" in friction
    assert "UTF-8" in file
