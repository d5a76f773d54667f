"""What is said where parts of an installation are missing, and where compiled code is kept."""

import os
import shutil
import stat
import subprocess

import pytest
from commands import python
from paths import ROOT

pytestmark = pytest.mark.serial
RUN = ["-m", "ringwear_par", "run", ROOT / "scripts/cases/paper.toml", "-o", "a.h5"]
BROKEN = {
    "petsc4py": ("ImportError('libmpi.so.12: no such file')", "does not load (libmpi.so.12"),
    "mpi4py": ("RuntimeError('cannot load\\nMPI library')", "does not load: cannot load MPI lib"),
}


@pytest.mark.parametrize("package", BROKEN)
def test_a_package_that_does_not_load_is_told_in_a_sentence(tmp_path, package):
    error, said = BROKEN[package]
    (tmp_path / "broken" / package).mkdir(parents=True)
    (tmp_path / "broken" / package / "__init__.py").write_text(f"raise {error}\n")
    (tmp_path / "out").mkdir()
    path = os.pathsep.join([str(tmp_path / "broken"), str(ROOT)])
    done = python(*RUN, cwd=tmp_path / "out", PYTHONPATH=path)
    assert done.returncode == 1
    (told,) = done.stderr.splitlines()
    assert told.startswith("ringwear: ")
    assert said in told
    assert not list((tmp_path / "out").iterdir())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the result of a run."""
    folder = tmp_path_factory.mktemp("run")
    assert python(*RUN, "--set", "time.steps=3", cwd=folder).returncode == 0
    return folder


def test_results_and_laws_are_looked_at_without_petsc(folder, tmp_path):
    (tmp_path / "broken" / "petsc4py").mkdir(parents=True)
    (tmp_path / "broken" / "petsc4py" / "__init__.py").write_text("raise ImportError('none')\n")
    path = os.pathsep.join([str(tmp_path / "broken"), str(ROOT)])
    # of fits too: where one rank alone reads them, it must not start PETSc
    program = """
import sys
import ringwear_par.reports.fit_page, ringwear_par.reports.spreadsheets
from ringwear_par.cli import main
for words in ("plot a.h5 -o a.png", "export a.h5 -o a.csv", "report a.h5 -o a.html", *sys.argv[1:]):
    assert main(words.split()) == 0, words
"""
    done = python("-c", program, f"laws {RUN[3]}", cwd=folder, PYTHONPATH=path)
    assert (done.returncode, done.stderr) == (0, "")
    fit = ROOT / "scripts/fit/plan.toml"
    done = python("-m", "ringwear_par", "design", fit, "-o", "out", cwd=tmp_path, PYTHONPATH=path)
    assert done.returncode == 1
    assert done.stderr.startswith("ringwear: PETSc for Python does not load (none)")


def test_nothing_is_said_where_no_home_may_be_written(folder):
    nowhere = {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null", "XDG_CONFIG_HOME": "/dev/null"}
    words = ["-m", "ringwear_par", "plot", "a.h5", "-o", "drawn.png"]
    done = python(*words, cwd=folder, MPLCONFIGDIR="", **nowhere)
    assert (done.returncode, done.stderr) == (0, "")
    assert (folder / "drawn.png").exists()


@pytest.fixture
def unwritable(tmp_path):
    """A copy of the package beside which nothing can be kept, for root either; its environment."""
    package = tmp_path / "site" / "ringwear_par"
    shutil.copytree(ROOT / "ringwear_par", package, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "elasticity" / "bem" / "__pycache__").touch()
    (tmp_path / "tmp").mkdir()
    return {
        "PYTHONPATH": str(tmp_path / "site"), "PYTHONDONTWRITEBYTECODE": "1", "NUMBA_CACHE_DIR": "",
        "HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null", "TMPDIR": str(tmp_path / "tmp"),
    }  # fmt: skip


ELLIPTIC = "from ringwear_par.elasticity.bem.kernels import elliptic; print(elliptic(0.5)[0])"


def test_compiled_code_is_kept_in_a_private_folder_where_nothing_else_may_be_written(
    tmp_path, unwritable
):
    done = python("-c", ELLIPTIC, cwd=tmp_path, **unwritable)
    assert done.returncode == 0, done.stderr
    (kept,) = (tmp_path / "tmp").iterdir()
    assert stat.S_IMODE(kept.stat().st_mode) == 0o700
    assert list(kept.rglob("*.nbi"))
    # nor is anything taken from a folder that others may write to
    shutil.rmtree(kept)
    kept.mkdir()
    kept.chmod(0o777)
    again = python("-c", ELLIPTIC, cwd=tmp_path, **unwritable)
    assert again.returncode == 0, again.stderr
    assert again.stdout == done.stdout
    assert not list(kept.iterdir())


def test_a_changed_function_is_compiled_into_its_callers(tmp_path):
    package = tmp_path / "site" / "ringwear_par"
    shutil.copytree(ROOT / "ringwear_par", package, ignore=shutil.ignore_patterns("__pycache__"))
    folder = package / "elasticity" / "bem"
    callee, caller = (folder / f"{name}.py" for name in ("callee", "caller"))
    decorated = "from ringwear_par.elasticity.bem.compiling import compiled\n@compiled\ndef "
    callee.write_text(f"{decorated}factor():\n    return 1.0\n")
    caller.write_text(
        "from ringwear_par.elasticity.bem.callee import factor\n"
        f"{decorated}product(x):\n    return factor() * x\n"
    )
    program = (
        "from ringwear_par.elasticity.bem.caller import product as p; "
        "print(p(2.0), *p.stats.cache_hits.values())"
    )
    path = {"PYTHONPATH": str(tmp_path / "site"), "PYTHONDONTWRITEBYTECODE": "1"}
    assert python("-c", program, cwd=tmp_path, **path).stdout == "2.0\n"
    assert python("-c", program, cwd=tmp_path, **path).stdout == "2.0 1\n"
    callee.write_text(callee.read_text().replace("1.0", "1.5"))
    assert python("-c", program, cwd=tmp_path, **path).stdout == "3.0\n"


@pytest.mark.parametrize("shell", ["dash", "zsh"])
def test_setup_is_sourced_from_bash_only(tmp_path, shell):
    if not shutil.which(shell):
        pytest.skip(f"no {shell}")
    done = subprocess.run(
        [shell, "-c", f". '{ROOT}/scripts/setup.sh'; echo status $?"], cwd=tmp_path,
        capture_output=True, text=True, timeout=30, check=False,
    )  # fmt: skip
    assert "only bash can source this; here: bash scripts/setup.sh" in done.stderr
    assert done.stdout == "status 1\n"
    assert not list(tmp_path.iterdir())
