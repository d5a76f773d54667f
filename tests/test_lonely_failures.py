"""A rank that fails alone: all ranks end, with a sentence, whatever it was."""

import resource
import shutil

import pytest
from commands import NEEDS_MPIRUN, python
from paths import CASES, FIT, PAPER

#: the command, with little more address space on the last rank than it has once PETSc has started
SHORT = """
import resource, sys
from ringwear_par import cli, parallel

claim = parallel.claim_blas_memory

def short_of_memory(comm):
    if comm.rank == 1:
        with open("/proc/self/status") as file:
            size = next(int(line.split()[1]) for line in file if line.startswith("VmSize"))
        resource.setrlimit(resource.RLIMIT_AS, (1024 * size + 20_000_000, resource.RLIM_INFINITY))
    claim(comm)

parallel.claim_blas_memory = short_of_memory
sys.exit(cli.main(sys.argv[1:]))
"""
LAW = """
import os

calls = 0

def rate(p, at):
    global calls
    calls += 1
    if calls > 20 and os.environ["OMPI_COMM_WORLD_RANK"] == "1":
        raise KeyboardInterrupt
    return 1e-9 * p
"""


def sentences(command, folder):
    """What ringwear says on two ranks, which have to end with status 1."""
    done = python(*command, ranks=2, cwd=folder)
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    return [line for line in done.stderr.splitlines() if line.startswith("ringwear: ")]


def command_of(name):
    if name == "sweep":
        return "sweep", CASES / "study.toml", "-o", "out"
    return "fit", next(iter(sorted(FIT.glob("*.toml")))), "-o", "out"


@pytest.mark.serial
@NEEDS_MPIRUN
@pytest.mark.skipif(not hasattr(resource, "RLIMIT_AS"), reason="no limits of memory")
@pytest.mark.parametrize("name", ["sweep", "fit"])
def test_one_rank_short_of_memory_ends_all_with_a_sentence(tmp_path, name):
    """OpenBLAS would try for ever to get what it works in."""
    (said,) = sentences(["-c", SHORT, *command_of(name)], tmp_path)
    assert said == "ringwear: not enough memory: 0.3 GB to begin with"
    assert not list(tmp_path.iterdir())


@pytest.mark.serial
@NEEDS_MPIRUN
def test_a_law_that_interrupts_one_rank_ends_all_with_a_sentence(tmp_path):
    (tmp_path / "user_law.py").write_text(LAW)
    case = shutil.copy(CASES / "user_law.toml", tmp_path)
    words = ["-m", "ringwear_par", "run", case, "-o", "a.h5", "--set", "wear.lower.parameters={}"]
    (said,) = sentences(words, tmp_path)
    assert "stopped by a KeyboardInterrupt of" in said
    assert "user_law.py, line 10" in said


def test_a_rank_that_computes_nothing_more_keeps_nobody_waiting(comm, monkeypatch):
    """What fails on one rank between two collective calls is raised on all."""
    from ringwear_par.cases.files.reading import read_case
    from ringwear_par.studies.execution import many

    def simulated(*args, **options):
        if comm.rank == comm.size - 1:
            raise MemoryError("no more")
        return simulate(*args, **options)

    simulate = many._simulated
    monkeypatch.setattr(many, "_simulated", simulated)
    case = read_case(PAPER, ["mesh.contact_elements=8", "time.steps=2"])
    with pytest.raises(Exception, match="no more"):
        many.simulate_all([case] * (comm.size + 1), comm)
    comm.Barrier()


def test_contacts_that_fail_on_one_rank_do_not_wait_for_the_others(comm, paper_pair):
    from ringwear_par.history.physics import Physics

    case, pair = paper_pair
    if comm.rank == comm.size - 1:
        contacts = Physics.of([case], pair).contacts()
        with pytest.raises(MemoryError), contacts:
            raise MemoryError
        assert not contacts.warm.scaled_pressure.any()
    comm.Barrier()
