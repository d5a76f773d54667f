"""A rank of a team that fails alone takes the others with it, and nobody waits for ever."""

import pytest
from swept import CASE, table, write_study

from ringwear_par.errors import ComputationError
from ringwear_par.studies.execution.sweep import sweep
from ringwear_par.wear.law import Law
from ringwear_par.wear.laws.threshold import ThresholdLaw

pytestmark = pytest.mark.mpi(min_size=2)
STUDY = '[vary]\n"wear.lower.k" = { log = [1e-8, 1e-6], count = 3 }\n'
#: of the three cases, that with the second coefficient
FAILED = ["done", "failed", "done"]


@pytest.fixture
def swept(tmp_path, comm):
    """Sweep a study, all ranks a team."""

    def swept(case=CASE, **how):
        path = write_study(tmp_path, comm, STUDY, case)
        return sweep(path, tmp_path / "out", comm, ranks_per_case=comm.size, **how)

    return swept


def is_bad(law):
    return abs(law.k - 1e-7) < 1e-12


@pytest.mark.parametrize(("scheme", "calls"), [("implicit", 0), ("adaptive", 15)])
def test_a_law_that_raises_on_one_rank_fails_its_cases(
    swept, tmp_path, comm, monkeypatch, calls, scheme
):
    """In its first step, and in a later one."""
    case = CASE.replace("implicit", scheme)
    rate, made = ThresholdLaw.rate, []

    def raising(self, p, at):
        if is_bad(self) and comm.rank == comm.size - 1:
            made.append(self)
            if len(made) > calls:
                made.clear()
                raise RuntimeError("only here")
        return rate(self, p, at)

    monkeypatch.setattr(ThresholdLaw, "rate", raising)
    monkeypatch.setattr(ThresholdLaw, "line", Law.line)  # so that its rate is asked for
    with pytest.raises(ComputationError, match="1 of 3 cases failed"):
        swept(case)
    rows = table(tmp_path / "out")
    assert [row["status"] for row in rows] == FAILED
    assert {"only here" in row["error"] for row in rows if row["status"] == "failed"} == {True}
    monkeypatch.undo()
    assert swept(case, retry_failed=True).done == 3
