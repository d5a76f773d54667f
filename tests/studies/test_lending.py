"""Solvers that cases of a pair share: which ones do, and which never come back."""

import pytest
from swept import CASE, write_study

from ringwear_par.cases.reading import parse_case
from ringwear_par.contact.solver import ContactSolver
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.history.pairs import assemble
from ringwear_par.petsc import PETSc
from ringwear_par.studies import batches, lending
from ringwear_par.studies.lending import Lender
from ringwear_par.studies.many import simulate_all
from ringwear_par.studies.sweep import sweep

FOLLOWS = {"mesh.geometry": "updated", "mesh.geometry_tolerance": 1.0}


@pytest.fixture(scope="module")
def case():
    return parse_case(CASE, "case", {"time.steps": 2})


@pytest.fixture
def made(monkeypatch):
    """The solvers that lenders make."""
    made = []

    def noted(*words):
        made.append(ContactSolver(*words))
        return made[-1]

    monkeypatch.setattr(lending, "ContactSolver", noted)
    return made


def test_a_solver_serves_cases_of_the_same_moduli(case, comm, made):
    with Lender(assemble(case, comm), comm) as lender:
        first = lender.solver(case)
        assert lender.solver(case.replace({"wear.lower.k": 1e-8})) is first
        second = lender.solver(case.replace({"lower.young": 2e4}))
        assert second is not first
        assert lender.solver(case.replace(FOLLOWS)) is None
        lender.drop()
        third = lender.solver(case.replace({"lower.young": 2e4}))
    assert made == [first, second, third]
    assert all(not each._owned for each in made)


@pytest.mark.parametrize("how", ["simulate_all", "sweep"])
def test_no_solver_is_made_for_cases_that_follow_the_wear(case, comm, shared_path, made, how):
    case = case.replace({**FOLLOWS, "wear.lower.k": 1e-8})
    if how == "sweep":
        text = '[vary]\n"wear.lower.k" = { values = [1e-8, 2e-8] }\n'
        sweep(write_study(shared_path, comm, text, case.text), shared_path / "out", comm)
    else:
        simulate_all([case] * comm.size, comm)
    assert not made


@pytest.mark.parametrize("how", ["simulate_all", "sweep"])
def test_a_solver_that_failed_is_not_lent_again(
    case, comm, shared_path, made, monkeypatch, one_by_one, how
):
    """Every solver fails in its first contact: no case gets one that has."""
    solve, used = ContactSolver.solve, []

    def failing(self, *words, **how):
        if self not in used:
            used.append(self)
            raise ComputationError("TAO gave up")
        return solve(self, *words, **how)

    monkeypatch.setattr(ContactSolver, "solve", failing)
    loads = list(range(50, 50 + 3 * comm.size))
    if how == "sweep":
        text = f'[vary]\n"load.pressure" = {{ values = {loads} }}\n'
        with pytest.raises(ComputationError, match=f"{len(loads)} of {len(loads)} cases failed"):
            sweep(write_study(shared_path, comm, text, case.text), shared_path / "out", comm)
    else:
        monkeypatch.setattr(batches, "batch_key", lambda case: None)  # all of them stay alone
        found = simulate_all([case.replace({"load.pressure": p}) for p in loads], comm)
        assert ["TAO gave up" in str(each.error) for each in found] == [True] * len(loads)
    assert comm.allreduce(len(made)) == len(loads)
    assert all(not each._owned for each in made)


@pytest.mark.parametrize("option", ["contact_tao_max_it", "contact_tao_mox_it"])
def test_options_are_checked_where_no_solver_is_lent(case, comm, shared_path, option):
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
