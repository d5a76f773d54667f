"""The rooms: which may import which, and what stays light."""

import ast

import pytest
from commands import python
from paths import CASES, ROOT

HEAVY = ("mpi4py.MPI", "petsc4py.PETSc", "numba", "ringwear_par.elasticity.bem.assembly")

#: most modules of ours that one may know, and rooms where some still know more
MOST_IMPORTS = 15
IMPORTS_TO_DO = {"history", "identification"}

pytestmark = pytest.mark.serial


def test_import_directions():
    """The contracts of pyproject.toml: layers, no circles, PETSc where systems are solved."""
    program = "from importlinter.cli import lint_imports; raise SystemExit(lint_imports())"
    result = python("-c", program, cwd=ROOT)
    assert result.returncode == 0, result.stdout
    assert "4 kept, 0 broken" in result.stdout


def modules_known(path):
    """Return the modules of ours that a file imports, types and functions' own imports too."""
    modules = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module.startswith("ringwear_par"):
            names = {f"{node.module}.{alias.name}" for alias in node.names} | {node.module}
            modules |= {name for name in names if (ROOT / f"{name.replace('.', '/')}.py").exists()}
    return modules


def test_no_module_knows_many_others():
    package = ROOT / "ringwear_par"
    known = {path.relative_to(package): modules_known(path) for path in package.rglob("*.py")}
    many = {
        str(path): len(modules)
        for path, modules in known.items()
        if len(modules) > MOST_IMPORTS and path.parts[0] not in IMPORTS_TO_DO
    }
    assert not many


#: what is used one after another by one process, and what may not have been loaded by then
LIGHT = (
    ("import ringwear_par.contact.problem, ringwear_par.options", ("scipy", "h5py", "matplotlib")),
    ("rw.read_case(case).replace({'load.pressure': 50})", ("scipy", "h5py", "matplotlib")),
    ("from ringwear_par.cases.files.law_trials import check_laws", ()),
    ("check_laws(Path(cases) / 'user_law.toml', [])", ("scipy",)),
    ("rw.read_case(f'{cases}/sphere.toml')", ("h5py", "matplotlib")),
    ("rw.read_study(study)", ()),
    ("rw.open_result(run).to_xarray()", ()),
    ("rw.plot([rw.open_result(run), run], 'wear,penetration,pressure,section')", ()),
    ("rw.open_ensemble(folder).penetration", ()),
    ("rw.plot(folder)", ()),
    ("rw.report(run, f'{run}.html')", ()),
    ("rw.report(folder, f'{run}.html')", ()),
    ("f = rw.function(case, ['wear.lower.k'], ['torque@1'], derivatives=True)", ()),
    ("import pickle; pickle.loads(pickle.dumps(f))", ()),
    ("rw.surrogate, rw.WearLaw, rw.FailedResult, rw.InputError", ()),
    ("rw.measure(f'{cases}/../measure/measure.toml').save(f'{run}.measured')", ()),
)  # fmt: skip


def test_what_starts_neither_mpi_nor_petsc_nor_compiled_code(stored):
    program = f"""
import sys
from pathlib import Path
import ringwear_par as rw
case, study, run, folder, cases = sys.argv[1:]
for words, more in {LIGHT}:
    exec(words)
    heavy = [name for name in ({HEAVY} + more) if name in sys.modules]
    assert not heavy, (words, heavy)
"""
    result = python("-c", program, *stored, CASES)
    assert result.returncode == 0, result.stderr


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """Names of a case, a study, a result file and the folder of a sweep."""
    folder = tmp_path_factory.mktemp("stored")
    case, study = folder / "case.toml", folder / "study.toml"
    text = (ROOT / "scripts/cases/paper.toml").read_text()
    case.write_text(f"{text}\n[mesh]\ncontact_elements = 8\n".replace("steps = 200", "steps = 3"))
    study.write_text('case = "case.toml"\n[vary]\n"load.pressure" = { values = [50, 60] }\n')
    program = """
import sys
import ringwear_par as rw
case, study, run, folder = sys.argv[1:]
rw.simulate(rw.read_case(case)).save(run)
rw.sweep(rw.read_study(study), folder)
"""
    names = case, study, folder / "run.h5", folder / "out"
    result = python("-c", program, *names)
    assert result.returncode == 0, result.stderr
    return names
