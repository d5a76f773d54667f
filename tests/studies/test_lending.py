"""Options of PETSc in sweeps whose cases assemble elements of their own."""

import pytest
from swept import CASE, write_study

from ringwear_par.cases.files.reading import parse_case
from ringwear_par.errors import InputError
from ringwear_par.petsc import PETSc
from ringwear_par.studies.execution.sweep import sweep

FOLLOWS = {"mesh.geometry": "updated", "mesh.geometry_tolerance": 1.0}


@pytest.fixture(scope="module")
def case():
    return parse_case(CASE, "case", {"time.steps": 2})


@pytest.mark.parametrize("option", ["contact_tao_max_it", "contact_tao_mox_it"])
def test_options_are_checked_where_elements_follow_the_wear(case, comm, shared_path, option):
    """Only the solvers of the cases themselves can have read them."""
    case = case.replace({**FOLLOWS, "wear.lower.k": 1e-8})
    text = '[vary]\n"load.pressure" = { values = [50, 60] }\n'
    study = write_study(shared_path, comm, text, case.text)
    options = PETSc.Options()
    options[option] = 300
    try:
        if option == "contact_tao_max_it":
            assert sweep(study, shared_path / "out", comm).done == 2
        else:
            with pytest.raises(InputError, match=f"-{option}: no solver of this run reads"):
                sweep(study, shared_path / "out", comm)
    finally:
        options.delValue(option)
