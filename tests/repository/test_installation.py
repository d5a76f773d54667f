"""Where parts of an installation are missing: what is said, and what works all the same."""

import os
import shutil
import subprocess

import pytest
from commands import python
from paths import PAPER, ROOT

import ringwear_par as rw

BROKEN = {
    "petsc4py": ("ImportError('no libmpi.so.12')", ("libmpi.so.12", "conda-forge", "Debian")),
    "mpi4py": ("RuntimeError('cannot load\\nMPI library')", ("mpi4py", "MPI library")),
}


def without(package, folder, error="ImportError('none')"):
    """Return a PYTHONPATH on which a package does not load."""
    (folder / "broken" / package).mkdir(parents=True)
    (folder / "broken" / package / "__init__.py").write_text(f"raise {error}\n")
    return os.pathsep.join([str(folder / "broken"), str(ROOT)])


@pytest.mark.parametrize("package", BROKEN)
def test_a_package_that_does_not_load_is_named_in_a_sentence(tmp_path, package):
    error, words = BROKEN[package]
    path, output = without(package, tmp_path, error), tmp_path / "a.h5"
    done = python("-m", "ringwear_par", "run", PAPER, "-o", output, PYTHONPATH=path)
    assert done.returncode == 1
    (sentence,) = done.stderr.splitlines()
    assert all(word in sentence for word in ("ringwear: ", *words))
    assert not output.exists()


def test_results_are_looked_at_without_petsc(tmp_path):
    rw.simulate(rw.read_case(PAPER, {"time.steps": 3})).save(tmp_path / "a.h5")
    commands = [["plot", "a.h5", "-o", "a.png"], ["export", "a.h5", "-o", "a.csv"],
                ["report", "a.h5", "-o", "a.html"]]  # fmt: skip
    code = f"from ringwear_par.cli import main; print([main(words) for words in {commands}])"
    done = python("-c", code, cwd=tmp_path, PYTHONPATH=without("petsc4py", tmp_path))
    assert (done.stderr, done.stdout.splitlines()[-1:]) == ("", ["[0, 0, 0]"])


@pytest.mark.skipif(not shutil.which("dash"), reason="no dash")
def test_setup_is_sourced_from_bash_only(tmp_path):
    words = ["dash", "-c", f". '{ROOT}/scripts/setup.sh'; echo status $?"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "bash" in done.stderr
    assert done.stdout == "status 1\n"
