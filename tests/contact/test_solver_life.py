"""Errors out of TAO's callbacks, and the life of PETSc's objects."""

import weakref

import numpy as np
import pytest
from commands import NEEDS_MPIRUN, python
from one_contact import engine_of
from paths import HELPERS, ROOT
from petsc4py import PETSc

from ringwear_par.contact import engine as module
from ringwear_par.contact import tao
from ringwear_par.contact.engine import ContactEngine
from ringwear_par.contact.problem import WarmStart
from ringwear_par.errors import ComputationError, LawError

pytestmark = pytest.mark.serial

N = 8
COMPLIANCE = np.eye(N) + 0.1
AREA = np.ones(N)
FLAT, THREE = np.zeros((1, N)), np.array([3.0])


def start_anew(solver):
    """Let the next solve start as a new solver would."""
    solver.warm = WarmStart(np.zeros((1, N)), np.zeros(1))


def test_what_is_made_is_freed_if_the_rest_cannot_be_made(monkeypatch):
    made = []

    def too_large(*parts):
        made.extend(part for part in parts if isinstance(part, PETSc.Object))
        raise MemoryError

    monkeypatch.setattr(module, "set_from_options", too_large)
    with pytest.raises(MemoryError):
        engine_of(COMPLIANCE, AREA)
    assert made
    assert not any(part.handle for part in made)


def test_what_is_left_is_freed_in_the_order_of_making(monkeypatch):
    """Ranks that free shared objects in different orders wait for each other."""
    made = [engine_of(COMPLIANCE, AREA) for _ in range(20)]
    freed, destroy = [], ContactEngine.destroy

    def recorded(solver):
        freed.append(solver)
        destroy(solver)

    monkeypatch.setattr(ContactEngine, "destroy", recorded)
    tao._destroy_open()
    assert [solver for solver in freed if solver in made] == made
    assert not any(solver._tao.handle for solver in made)
    monkeypatch.undo()


class _Wrapping:
    """A TAO of petsc4py from 3.19 on, which wraps what a callback raises; of a TAO in it, twice."""

    def __init__(self, tao):
        self.tao = tao

    def __getattr__(self, name):
        return getattr(self.tao, name)

    def solve(self):
        try:
            try:
                self.tao.solve()
            except BaseException as error:
                raise PETSc.Error(-1) from error
        except PETSc.Error as error:
            raise PETSc.Error(101) from error


RAISED = [LawError("wear: failed"), ZeroDivisionError("of a law"), KeyboardInterrupt()]


def solver_of(kind):
    """Return a solver of a TAO type, on each rank its own."""
    options = PETSc.Options()
    options["contact_tao_type"] = kind
    try:
        return engine_of(COMPLIANCE, AREA)
    finally:
        options.delValue("contact_tao_type")


@pytest.mark.parametrize("wrapped", [False, True], ids=["as it comes", "wrapped"])
@pytest.mark.parametrize("kind", ["python", "tron", "bnls"])
@pytest.mark.parametrize("error", RAISED, ids=repr)
def test_what_is_raised_inside_tao_comes_out_as_it_is(kind, error, wrapped, monkeypatch):
    """Of a law, of what is around it in a callback, of a solver of our own; at any time."""
    gap, force = np.linspace(0.0, 0.3, N)[None] ** 2, np.array([0.05])
    with solver_of(kind) as solver:
        before = solver.solve(gap, force=force)
        if wrapped:
            monkeypatch.setattr(solver, "_tao", _Wrapping(solver._tao))
        places = [(solver._problem, "evaluate"), (solver._problem, "slopes")]
        if kind == "python":
            places = [*places[1:], (solver._problem, "judge"), (solver._hessians, "take_steps")]
        for place, name in places:
            works, left = getattr(place, name), 0

            def fails(*args, works=works, **keywords):
                nonlocal left
                left -= 1
                if left < 0:
                    raise error
                return works(*args, **keywords)

            for good in (0, 1, 2):  # calls before it
                start_anew(solver)
                left = good
                with monkeypatch.context() as patch:
                    patch.setattr(place, name, fails)
                    with pytest.raises(type(error)) as caught:
                        solver.solve(gap, force=force)
                assert caught.value is error
                assert caught.value.__cause__ is None
        # and the solver goes on as if nothing had been
        start_anew(solver)
        after = solver.solve(gap, force=force)
        assert np.array_equal(after.pressure, before.pressure)


def test_an_error_of_petsc_itself_is_told(monkeypatch):
    def fails(*_):
        raise PETSc.Error(73)

    with solver_of("python") as solver:
        monkeypatch.setattr(solver, "_tao", _Wrapping(solver._tao))
        monkeypatch.setattr(solver._hessians, "take_steps", fails)
        with pytest.raises(ComputationError, match=r"TAO python failed \(PETSc error 73\)"):
            solver.solve(FLAT, force=THREE)


def test_destroying_twice_is_harmless(comm):
    with engine_of(COMPLIANCE, AREA) as solver:
        solver.solve(FLAT, force=THREE)
    solver.destroy()
    solver.destroy()


def test_the_last_reference_frees_the_solver(comm):
    """Callbacks know neither the TAO nor the solver, so no collection of garbage is waited for."""
    solver = engine_of(COMPLIANCE, AREA)
    solver.solve(FLAT, force=THREE)
    tao, alive = solver._tao, weakref.ref(solver)
    assert tao.handle
    del solver
    assert alive() is None
    assert not tao.handle


#: tells, after all that was registered later has run, whether the TAO is alive
ALIVE_TO_THE_END = """
import atexit
from ringwear_par.petsc import PETSc
atexit.register(lambda: print(bool(engine._tao.handle)))
import numpy as np
from one_contact import engine_of
engine = engine_of(np.eye(8) + 0.1, np.ones(8))
assert engine._tao.handle
"""


def test_a_solver_that_is_alive_at_the_end_is_freed_before_petsc_ends():
    done = python("-c", ALIVE_TO_THE_END, PYTHONPATH=f"{ROOT}:{HELPERS}")
    assert (done.returncode, done.stdout, done.stderr) == (0, "False\n", "")


#: fails in the midst of a history, inside of TAO
FAILING = """
def rate(p, at):
    if at.time > 1.5:
        raise RuntimeError("of the law")
    return 1e-8 * at.speed * p
"""
RUN_OF_A_FAILING_LAW = """
import sys
import traceback
from dataclasses import replace
from mpi4py import MPI
import ringwear_par as rw

how, kind, file = sys.argv[1:]
names = {}
exec(open(file).read(), names)

class Mine:
    remembers = False

    def rate(self, p, local):
        return names["rate"](p, local)

keys = {
    "mesh.contact_elements": 16, "time.step": 1.0, "time.steps": 4,
    "wear.lower": None, "wear.lower.law": "user", "wear.lower.file": file,
}
of_file = rw.read_case("scripts/cases/paper.toml", keys)
kinds = {"file": of_file, "object": replace(of_file, wear_lower=Mine())}
for case in kinds.values() if how == "caught" else ():
    good = rw.read_case("scripts/cases/paper.toml", {**keys, "time.steps": 1})
    good, failed = rw.simulate_all([good, case])
    assert isinstance(good, rw.Result) and isinstance(failed, rw.FailedResult)
    assert "of the law" in str(failed.error)
    try:
        rw.simulate(case)
    except rw.ComputationError as error:
        kept = error
    frames, cause = [], kept
    while cause is not None:
        frames += [frame.name for frame in traceback.extract_tb(cause.__traceback__)]
        cause = cause.__cause__
    # errors that ranks tell each other have lost theirs
    assert "rate" in frames or MPI.COMM_WORLD.size > 1, frames
if how == "not caught":
    rw.simulate(kinds[kind])
"""


@pytest.mark.parametrize(
    ("ranks", "how", "kind", "status"),
    [
        (0, "caught", "both", 0), (0, "not caught", "file", 1),
        pytest.param(2, "not caught", "object", 1, marks=NEEDS_MPIRUN),
    ],
)  # fmt: skip
def test_a_law_that_fails_in_the_midst_leaves_the_status_alone(tmp_path, ranks, kind, how, status):
    """What a law raised holds frames, and these TAO's own references to itself."""
    law = tmp_path / "law.py"
    law.write_text(FAILING)
    done = python("-c", RUN_OF_A_FAILING_LAW, how, kind, law, ranks=ranks, cwd=ROOT)
    assert done.returncode == status, done.stderr
    said = done.stdout + done.stderr
    for word in ("MPI_ABORT", "PETSC ERROR", "Segmentation", "Exception ignored"):
        assert word not in said, said
