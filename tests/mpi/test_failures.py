"""What fails, on one rank or on all, ends alike on all, and the others go on."""

import pytest
from mpi4py import MPI
from paths import CASES, PAPER

import ringwear_par as rw
from ringwear_par.parallel import on_first_rank, together

pytestmark = pytest.mark.mpi

SMALL = {"mesh.contact_elements": 12, "time.steps": 3}
#: raises where the coefficient is a certain one, on one rank, once a history is under way
LAW = """
from mpi4py import MPI

calls = 0

def rate(p, at):
    global calls
    k = at.parameters["k"]
    calls += 1
    if k > 1.5e-7 and calls > {calls} and MPI.COMM_WORLD.rank == MPI.COMM_WORLD.size - 1:
        raise RuntimeError("only here")
    return k * p
"""


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (rw.InputError("one", "two"), rw.InputError),
        (rw.ComputationError("one"), rw.ComputationError),
        (OSError(28, "one", "a.h5"), Exception),
        (ZeroDivisionError("one"), Exception),
    ],
)
def test_an_error_of_one_rank_reaches_all(comm, error, kind):
    for failing in {0, comm.size - 1}:
        with pytest.raises(kind, match="one"), together(comm):  # noqa: PT012
            if comm.rank == failing:
                raise error
        comm.Barrier()


@pytest.mark.parametrize("error", [OSError(28, "no room", "a.h5"), rw.InputError("no room")])
def test_an_error_of_the_first_rank_reaches_all(comm, error):
    def fail():
        raise error

    with pytest.raises(Exception, match="no room"):
        on_first_rank(comm, fail)
    assert on_first_rank(comm, lambda: 3) == 3


@pytest.mark.parametrize("calls", [0, 10])
@pytest.mark.parametrize("scheme", ["implicit", "explicit"])
def test_a_law_that_raises_fails_its_case(comm, mpi_tmp_path, scheme, calls):
    """Alone or shared by all ranks; what ranks have of it is the same."""
    if comm.rank == 0:
        (mpi_tmp_path / "law.py").write_text(LAW.replace("{calls}", str(calls)))
    comm.Barrier()
    wear = {"law": "user", "file": str(mpi_tmp_path / "law.py"), "parameters": {"k": 1e-7}}
    base = rw.read_case(PAPER, {**SMALL, "time.scheme": scheme, "time.step": 0.05})
    good = base.replace({"wear.lower": wear})
    bad = base.replace({"wear.lower": {**wear, "parameters": {"k": 2e-7}}})
    found = rw.simulate_all([good, *[bad] * comm.size, good], comm, batch=1)
    kinds = [type(one).__name__ for one in found]
    assert kinds[0] == kinds[-1] == "Result"
    assert "FailedResult" in kinds
    assert all("only here" in str(one.error) for one in found if hasattr(one, "error"))
    assert comm.allgather(kinds) == [kinds] * comm.size
    with pytest.raises(rw.ComputationError, match="only here"):
        rw.simulate(bad, comm)
    comm.Barrier()


def test_a_case_that_cannot_be_is_refused_on_all(comm):
    with pytest.raises(rw.InputError, match="upper"):
        rw.simulate_all([rw.read_case(PAPER, {**SMALL, "upper.r": [50, 60]})], comm)


def test_a_step_that_fails_names_its_time(comm):
    """On all ranks: half of the body is worn off."""
    case = rw.read_case(PAPER, {**SMALL, "wear.lower.k": 1e-3, "time.step": 500.0})
    with pytest.raises(rw.ComputationError, match="half"):
        rw.simulate(case, comm)
    assert isinstance(rw.simulate_all([case], comm)[0], rw.FailedResult)


@pytest.mark.parametrize(
    ("file", "keys"),
    [(PAPER, {"lower.young": -1}), (PAPER, {"lower.yung": 1}), (CASES / "no.toml", {})],
)
def test_a_bad_case_is_refused_on_all(comm, file, keys):
    with pytest.raises(rw.InputError) as error:
        on_first_rank(comm, lambda: rw.read_case(file, keys))
    assert len(set(comm.allgather(str(error.value)))) == 1


@pytest.mark.parametrize("file", [CASES / "no.toml", PAPER])
def test_a_bad_study_or_fit_is_refused_on_all(comm, mpi_tmp_path, file):
    for start in (lambda: rw.sweep(file, mpi_tmp_path / "out", comm), lambda: rw.fit(file, comm)):
        with pytest.raises(rw.InputError):
            start()
        comm.Barrier()
    assert not list(mpi_tmp_path.iterdir())


def test_a_sweep_keeps_its_other_cases(comm, mpi_tmp_path):
    """A failed case is a row with its reason; once more computes that case only."""
    if comm.rank == 0:
        (mpi_tmp_path / "base.toml").write_text(
            PAPER.read_text().replace("steps = 200", "steps = 3\n[mesh]\ncontact_elements = 12")
        )
        (mpi_tmp_path / "study.toml").write_text(
            'case = "base.toml"\n[vary]\n"time.step" = { values = [1.0, 2.0, 5e6] }\n'
        )
    comm.Barrier()
    for retry in (False, True):
        with pytest.raises(rw.ComputationError, match="1 of 3"):
            rw.sweep(mpi_tmp_path / "study.toml", mpi_tmp_path / "out", comm, retry_failed=retry)
        comm.Barrier()
        rows = (mpi_tmp_path / "out" / "cases.csv").read_text().splitlines()[1:]
        assert sum(",done," in row for row in rows) == 2
        comm.Barrier()


def test_a_disk_that_fails_one_rank(comm, mpi_tmp_path, monkeypatch):
    """The others take over its blocks; then the same command merges."""

    def full(*_):
        raise OSError(28, "No space left on device", "block.h5")

    study = {"case": str(PAPER), "vary": {key: {"values": [v]} for key, v in SMALL.items()}}
    study["vary"]["load.pressure"] = {"values": [50, 60, 70, 80, 90]}
    with monkeypatch.context() as patch:
        patch.setattr("ringwear_par.studies.many.MOST", 1)
        if comm.rank == comm.size - 1:
            patch.setattr("ringwear_par.studies.sweep.write_block", full)
        with pytest.raises(rw.ComputationError, match="No space left on device; 5 of 5 blocks"):
            rw.sweep(study, mpi_tmp_path / "out", comm)
        comm.Barrier()
        assert rw.sweep(study, mpi_tmp_path / "out", comm).done == 5


def test_the_world_is_what_is_meant_without_a_communicator():
    """As in PETSc."""
    case = rw.read_case(PAPER, SMALL)
    wear = rw.simulate(case).to_xarray()["wear_lower"].to_numpy()
    assert len(set(MPI.COMM_WORLD.allgather(wear.tobytes()))) == 1
