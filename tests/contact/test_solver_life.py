"""Errors of laws in the midst of a contact: they come out as they are, and nothing hangs on."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from commands import NEEDS_MPIRUN, python
from parts import LawError, PowerLaw, WearIncrement
from paths import ROOT

import ringwear_par as rw
from ringwear_par.contact.engine import TAO_TYPES, ContactEngine
from ringwear_par.contact.problem import WarmStart
from ringwear_par.contact.scaled_compliances import ScaledCompliances

N = 8
COMPLIANCE = np.eye(N) + 0.1
AREA = np.ones(N)
RAISED = [LawError("wear: failed"), KeyboardInterrupt()]


@dataclass(frozen=True)
class Failing(PowerLaw):
    """Raises at one of its calls."""

    error: BaseException | None = None
    left: list[int] = field(default_factory=list, compare=False)

    def rate(self, p, at):
        """Return the rate, or raise."""
        self.left[0] -= 1
        if self.left[0] < 0:
            raise self.error
        return super().rate(p, at)


@pytest.mark.parametrize("kind", TAO_TYPES)
@pytest.mark.parametrize("error", RAISED, ids=repr)
def test_what_is_raised_inside_tao_comes_out_as_it_is(kind, error):
    gap, force = np.linspace(0.0, 0.3, N)[None] ** 2, np.array([0.05])
    radii = np.ones((1, N))
    at = rw.LocalState(np.zeros(1), radii[0], radii, np.ones(1), 0.0 * radii, 0.0 * radii)
    law = Failing(0.1, 1.5, error=error, left=[0])
    wear = WearIncrement((law, None), (at, at), np.ones(1), (None, None))
    compliances = ScaledCompliances.of(COMPLIANCE[None], AREA)
    with ContactEngine(compliances, np.zeros(1, dtype=int), kind) as solver:

        def solve(calls):
            solver.warm, law.left[0] = WarmStart(np.zeros((1, N)), np.zeros(1)), calls
            return solver.solve(gap, force=force, wear=wear)

        before = solve(10**6)
        for good in (0, 1, 2):  # calls before it
            with pytest.raises(type(error)) as caught:
                solve(good)
            assert caught.value is error
        # and the solver goes on as if nothing had been
        assert np.array_equal(solve(10**6).pressure, before.pressure)


#: fails in the midst of a history, inside of TAO
FAILING = """
def rate(p, at):
    if at.time > 1.5:
        raise RuntimeError("of the law")
    return 1e-8 * at.speed * p
"""
RUN_OF_A_FAILING_LAW = """
import sys
import ringwear_par as rw

keys = {
    "mesh.contact_elements": 16, "time.step": 1.0, "time.steps": 4,
    "wear.lower": None, "wear.lower.law": "user", "wear.lower.file": sys.argv[2],
}
case = rw.read_case("scripts/cases/paper.toml", keys)
if sys.argv[1] == "caught":
    good, failed = rw.simulate_all([case.replace({"time.steps": 1}), case])
    assert isinstance(good, rw.Result) and isinstance(failed, rw.FailedResult)
    assert "of the law" in str(failed.error)
    try:
        rw.simulate(case)
    except rw.ComputationError as error:
        kept = error
else:
    rw.simulate(case)
"""


@pytest.mark.parametrize(
    ("ranks", "how", "status"),
    [(0, "caught", 0), (0, "not caught", 1),
     pytest.param(2, "not caught", 1, marks=NEEDS_MPIRUN)],
)  # fmt: skip
def test_a_law_that_fails_in_the_midst_leaves_the_status_alone(tmp_path, ranks, how, status):
    """What a law raised holds frames, and these TAO's own references to itself."""
    law = tmp_path / "law.py"
    law.write_text(FAILING)
    done = python("-c", RUN_OF_A_FAILING_LAW, how, law, ranks=ranks, cwd=ROOT)
    assert done.returncode == status, done.stderr
    said = done.stdout + done.stderr
    for word in ("MPI_ABORT", "PETSC ERROR", "Segmentation", "Exception ignored"):
        assert word not in said, said
