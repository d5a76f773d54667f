"""Histories, files, sweeps and fits have the same numbers on any number of ranks."""

import csv

import numpy as np
import pytest
from drawn import draws_of, fit_of
from laboratory import TRUTH, fit_tables, write_tests
from mpi4py import MPI
from parts import run_sweep
from paths import CASES, PAPER

import ringwear_par as rw

pytestmark = pytest.mark.mpi

ALONE = MPI.COMM_SELF
SMALL = {"mesh.contact_elements": 16}
STEPS = {**SMALL, "time.steps": 10}
MOVING = {"mesh.geometry": "updated", "mesh.geometry_tolerance": 1e-3, "time.step": 8.0}
ADAPTIVE = {"time.scheme": "adaptive", "time.end": 60.0}
GRID = {"body": "lower", "r": [28.0, 32.0], "z": [18.5, 19.9], "n": [4, 3]}
#: by what is special about it: the case and its keys
HISTORIES = {
    "implicit": ("paper", {}),
    "explicit": ("paper", {"time.scheme": "explicit", "time.step": 0.05}),
    "adaptive": ("paper", ADAPTIVE),
    "times of output": ("paper", {**ADAPTIVE, "output.times": [1.0, 5.0, 6.5]}),
    "updated": ("paper", MOVING),
    "updated, adaptive": ("paper", {**ADAPTIVE, **MOVING, "time.step": None}),
    "chamfer": ("chamfer", {}),
    "crown": ("crown", {"time.end": 100.0}),
    "two layers": ("two_layers", {}),
    "wear through": ("wear_through", {"time.end": 90.0}),
    "running in": ("running_in", {"time.end": 60.0}),
    "non local": ("non_local", {}),
    "cycles": ("cycles", {"time.end": 65.0}),
    "law of a file": ("user_law", {"time.end": 60.0}),
    "stress": ("paper", {"stress.grid": GRID, "stress.times": "all"}),
    "fields": ("fields", {}),
}
#: what depends on clocks
CLOCKS = ("seconds", "ranks")


def case_of(name):
    """Return one of the cases on few elements, with few steps."""
    stem, keys = HISTORIES[name]
    case = rw.read_case(CASES / f"{stem}.toml", SMALL)
    fixed = "time.end" not in keys and "adaptive" not in case.text
    return case.replace({**({"time.steps": 10} if fixed else {}), **keys})


def assert_same(one, other, rel=1e-9):
    """Two datasets hold the same variables, equal but for round-off."""
    assert set(one.variables) == set(other.variables)
    for name, values in one.variables.items():
        found, known = np.asarray(values), np.asarray(other[name])
        assert found.shape == known.shape, name
        if found.dtype.kind == "f" and found.size:
            scale = np.nanmax(np.abs(known), initial=0.0)
            assert np.allclose(found, known, rtol=rel, atol=rel * scale, equal_nan=True), name
        else:
            assert (found == known).all(), name


@pytest.mark.parametrize("name", HISTORIES)
def test_a_history(comm, name):
    case = case_of(name)
    assert_same(rw.simulate(case, comm).to_xarray(), rw.simulate(case, ALONE).to_xarray())


def test_again_gives_the_same_bits(comm):
    one, again = (rw.simulate(case_of("implicit"), comm).to_xarray() for _ in range(2))
    assert one.equals(again)


def test_ranks_hold_the_same(comm):
    wear = rw.simulate(case_of("adaptive"), comm).to_xarray()["wear_lower"].to_numpy()
    assert len(set(comm.allgather(wear.tobytes()))) == 1


@pytest.mark.parametrize("grip", ["clamped", "platen"])
@pytest.mark.parametrize("stem", ["paper", "chamfer", "two_layers", "sphere"])
def test_an_operator(comm, stem, grip):
    """To the last bit, as each system is solved by one rank."""
    case = rw.read_case(CASES / f"{stem}.toml", {**SMALL, "upper.grip": grip})
    found, known = rw.assemble(case, comm), rw.assemble(case, ALONE)
    for name in ("normal", "twist", "force_reaction", "torque_reaction", "slope"):
        assert np.array_equal(getattr(found, name), getattr(known, name)), name


@pytest.mark.parametrize("number", [1, 2, 7])
def test_many_cases(comm, number):
    """In their order, of two shapes, whoever computed them."""
    cases = [
        rw.read_case(PAPER, {**STEPS, "wear.lower.k": 1e-7 * (1 + i), "lower.r": [20, 40 + i % 2]})
        for i in range(number)
    ]
    found, known = rw.simulate_all(cases, comm), rw.simulate_all(cases, ALONE)
    for one, other in zip(found, known, strict=True):
        assert_same(one.to_xarray(), other.to_xarray(), 1e-12)


def test_a_file(comm, mpi_tmp_path):
    """What one rank writes is what all computed."""
    case = case_of("adaptive")
    rw.simulate(case, comm).save(mpi_tmp_path / "run.h5")
    comm.Barrier()
    stored = rw.open_result(mpi_tmp_path / "run.h5").to_xarray()
    assert_same(stored, rw.simulate(case, ALONE).to_xarray())


def study_of(path, comm, scheme="adaptive"):
    """Write a study of six cases of two operators; return its path."""
    if comm.rank == 0:
        steps = 'scheme = "adaptive"\nend = 50.0' if scheme == "adaptive" else (
            f'scheme = "{scheme}"\nstep = 0.05\nsteps = 12')  # fmt: skip
        text = PAPER.read_text().partition("[time]")[0]
        (path / "base.toml").write_text(f"{text}[time]\n{steps}\n[mesh]\ncontact_elements = 16\n")
        (path / "study.toml").write_text(
            'case = "base.toml"\n[vary]\n'
            '"wear.lower.k" = { log = [1e-8, 1e-6], count = 3 }\n'
            '"upper.young" = { values = [5e4, 1e5] }\n'
            '"lower.r" = { values = [[20, 40], [20, 41]] }\n'
        )
    comm.Barrier()
    return path / "study.toml"


def rows_of(folder):
    """Return the rows of cases.csv but for their clocks, in the order of the study."""
    with (folder / "cases.csv").open(newline="") as file:
        return [{k: v for k, v in row.items() if k not in CLOCKS} for row in csv.DictReader(file)]


@pytest.fixture
def small_blocks(monkeypatch):
    """Blocks of two cases, for all ranks to have some."""
    monkeypatch.setattr("ringwear_par.studies.many.MOST", 2)


@pytest.mark.parametrize("scheme", ["adaptive", "implicit", "explicit"])
@pytest.mark.usefixtures("small_blocks")
def test_a_sweep(comm, mpi_tmp_path, scheme):
    study = study_of(mpi_tmp_path, comm, scheme)
    rw.sweep(study, mpi_tmp_path / "all", comm)
    if comm.rank == 0:
        rw.sweep(study, mpi_tmp_path / "one", ALONE)
    comm.Barrier()
    assert rows_of(mpi_tmp_path / "all") == rows_of(mpi_tmp_path / "one")
    found, known = (rw.open_ensemble(mpi_tmp_path / folder) for folder in ("all", "one"))
    drop = [name for name in found.variables if name in CLOCKS]
    assert_same(found.drop_vars(drop), known.drop_vars(drop), 1e-12)


@pytest.mark.usefixtures("small_blocks")
def test_a_sweep_of_teams(comm, mpi_tmp_path):
    """All ranks share each case."""
    study = study_of(mpi_tmp_path, comm)
    rw.sweep(study, mpi_tmp_path / "team", comm, ranks_per_case=comm.size)
    if comm.rank == 0:
        rw.sweep(study, mpi_tmp_path / "one", ALONE)
    comm.Barrier()
    found, known = (rows_of(mpi_tmp_path / folder) for folder in ("team", "one"))
    for one, other in zip(found, known, strict=True):
        assert float(one["penetration"]) == pytest.approx(float(other["penetration"]), rel=1e-9)


@pytest.mark.usefixtures("small_blocks")
def test_a_sweep_goes_on_with_other_ranks(comm, mpi_tmp_path, capfd):
    """What one rank has begun all finish."""
    study = study_of(mpi_tmp_path, comm)
    if comm.rank == 0:
        run_sweep(study, mpi_tmp_path / "out", ALONE, dry_run=True)
        assert "one block of 2 cases" in capfd.readouterr().out
        rw.sweep(study, mpi_tmp_path / "one", ALONE)
    comm.Barrier()
    summary = rw.sweep(study, mpi_tmp_path / "out", comm)
    assert (summary.done, summary.computed) == (12, 10)
    found, known = (rw.open_ensemble(mpi_tmp_path / folder) for folder in ("out", "one"))
    drop = [name for name in found.variables if name in CLOCKS]
    assert found.drop_vars(drop).equals(known.drop_vars(drop))


@pytest.fixture
def tables(mpi_tmp_path, comm):
    """Return the fit file of one test, as a dict."""
    tests = comm.bcast(write_tests(mpi_tmp_path, (60.0,)) if comm.rank == 0 else None)
    found = fit_tables(mpi_tmp_path, tests)
    del found["fit"]["parameters"]["wear.lower.p0"]
    found["experiment"][0]["set"]["wear.lower.p0"] = TRUTH["wear.lower.p0"]
    return found


def test_a_fit(comm, tables):
    """The same draws, whoever computed their histories; the law has no history somewhere."""
    law = {"wear.lower.law": "running-in", "wear.lower.distance": 1000.0, "wear.lower.p0": 0.0}
    tables["experiment"][0]["set"] |= law
    k = tables["fit"]["parameters"]["wear.lower.k"]
    tables["fit"]["parameters"]["wear.lower.k_start"] = {**k, "start": 2e-7}
    found, known = rw.fit(tables, comm), rw.fit(tables, ALONE)
    np.testing.assert_allclose(found.draws.material, known.draws.material, rtol=1e-9)
    assert found.solution.failed == known.solution.failed > 0
    assert found.to_dict()["parameters"].keys() == known.to_dict()["parameters"].keys()


def test_a_design(comm, tables):
    """The same next test, which every rank returns."""
    tables["design"] = {"vary": {"load.pressure": [40.0, 96.0]}, "budget": {"experiments": 2}}
    found, known = rw.design(tables, comm).to_dict(), rw.design(tables, ALONE).to_dict()
    assert found["designs"][0]["experiments"] == known["designs"][0]["experiments"]


def test_a_prediction(comm):
    """The same draws and random wear, whoever computed their histories."""
    case = case_of("adaptive")
    fit = fit_of(draws_of(case, p0=np.linspace(0.0, 30.0, 200), tau=0.2, size=1e-5))
    found, known = (rw.predict(fit, case, draws=7, comm=c).to_xarray() for c in (comm, ALONE))
    assert_same(found, known, 1e-12)
