"""Contact pairs that are kept on disk: found again, and not taken for others."""

from dataclasses import replace

import numpy as np
import pytest
from petsc4py import PETSc
from reference_cases import paper_case

import ringwear_par as rw
from ringwear_par.elasticity import pair_cache
from ringwear_par.elasticity.mesh import Mesh

N = 8


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(pair_cache.VARIABLE, str(tmp_path / "kept"))
    return tmp_path / "kept"


def is_new(pair):
    return pair.cost.kernel_evaluations > 0


def same(one, other):
    return one.key == other.key and all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("normal", "twist", "force_reaction", "torque_reaction", "slope")
    )


def test_other_shapes_are_others(folder, comm):
    case = paper_case(Mesh(N))
    lower = case.lower
    cases = [
        case,
        replace(case, mesh=Mesh(N, grading=2.6)),
        replace(case, lower=replace(lower, poisson=lower.poisson + 1e-16 * 2)),
        replace(case, upper=replace(case.upper, grip="platen")),
    ]
    assert all(is_new(rw.assemble(one, comm)) for one in cases)
    for one in cases:  # moduli, loads and how elements follow the wear make no difference
        stiff = replace(one, lower=replace(one.lower, young=3e5), friction=0.2)
        updated = replace(stiff, mesh=replace(one.mesh, geometry="updated"))
        assert not is_new(rw.assemble(updated, comm))


@pytest.mark.parametrize("how", ["flipped", "cut"])
def test_damaged_entries_are_assembled_anew(folder, comm, how):
    case = paper_case(Mesh(N))
    whole = rw.assemble(case, comm)
    (path,) = folder.iterdir()
    content = bytearray(path.read_bytes())
    content[500] ^= 1
    path.write_bytes(content if how == "flipped" else content[:-9])
    anew, again = rw.assemble(case, comm), rw.assemble(case, comm)
    assert is_new(anew)
    assert not is_new(again)
    assert same(whole, anew)
    assert same(whole, again)


def test_options_for_petsc_ask_for_assembly(folder, comm):
    case, options = paper_case(Mesh(N)), PETSc.Options()
    rw.assemble(case, comm)
    options["bem_ksp_type"] = "preonly"
    try:
        assert is_new(rw.assemble(case, comm))
    finally:
        del options["bem_ksp_type"]
