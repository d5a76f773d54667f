"""Stresses along interfaces: balances, neighbours inside, files, wear, doubts, pictures."""

import numpy as np
import pytest
from parts import SIDES, mises

import ringwear_par as rw
from ringwear_par.results.export import export

HARD = {"thickness": 0.05, "young": 1e5, "poisson": 0.3}
SOFT = {"thickness": 0.2, "young": 2e3, "poisson": 0.4}
ALIKE = {"thickness": 0.3, "young": 1e4, "poisson": 0.3}


def case_of(**more):
    changes = {key.replace("__", "."): value for key, value in more.items()}
    base = {
        "mesh.contact_elements": 24, "time.steps": 2, "time.step": 30.0, "contact.friction": 0.3,
        "stress.points": [[30.0, 19.0]],
    }  # fmt: skip
    return rw.read_case("scripts/cases/paper.toml", {**base, **changes})


def both_bodies(**more):
    return case_of(lower__layers=[HARD, {**SOFT, "young": 5e4}], upper__layers=[SOFT], **more)


@pytest.fixture(scope="module")
def result(comm):
    return rw.simulate(both_bodies(stress__times="all"), comm)


def areas(interface, inner):
    """Areas of elements whose mid-points are known, from the inner end on."""
    ends = [inner]
    for r in interface.r:
        ends.append(2.0 * r - ends[-1])
    return np.pi * np.diff(np.square(ends))


def test_force_and_torque_go_through_every_interface(result):
    """Layers are free at their sides: what the contact bears must go on, however often."""
    last = result.stress.states[-1]
    force, torque = (result.histories[name][-1] for name in ("force", "torque"))
    for body, (interface, inner) in enumerate(
        zip(result.stress.interfaces, (20.0, 28.5), strict=True)
    ):
        area = areas(interface, inner)
        for sides in last.interfaces[body]:
            for stress in sides:
                assert -(stress[:, 2] @ area) == pytest.approx(force, rel=2e-3)
                assert stress[:, 5] @ (area * interface.r) == pytest.approx(torque, rel=2e-3)
                assert abs(stress[:, 3] @ area) < force


def test_points_on_a_side_have_the_same(comm):
    plain = both_bodies()
    known = rw.simulate(plain, comm).stress
    asked = [
        (body, number, k, side)
        for body, of in enumerate(known.interfaces)
        for number in range(len(of.z))
        for k in (3, len(of.r) // 2)
        for side in (0, 1)
    ]
    points = [
        [known.interfaces[b].r[k], known.interfaces[b].z[i], SIDES[side]] for b, i, k, side in asked
    ]
    found = rw.simulate(plain.replace({"stress.points": points}), comm).stress.states[-1].points
    last = known.states[-1]
    for (b, i, k, side), stress in zip(asked, found, strict=True):
        np.testing.assert_allclose(stress, last.interfaces[b][i, side, k], rtol=1e-9, atol=1e-9)


def test_file_and_dataset(result, tmp_path):
    result.save(tmp_path / "run.h5")
    data = rw.open_result(tmp_path / "run.h5").to_xarray()
    assert data.equals(result.to_xarray())
    assert data.interface_stress_lower.dims == (
        "stress_step", "interface_lower", "side", "interface_element_lower", "component",
    )  # fmt: skip
    assert data.side.values.tolist() == ["above", "below"]
    assert data.interface_z_lower.values == pytest.approx([19.95, 19.75])
    assert data.interface_z_upper.values == pytest.approx([20.2])
    np.testing.assert_array_equal(
        data.interface_mises_upper, mises(data.interface_stress_upper.values)
    )


def worn_through(geometry, step, **more):
    """A thin hard coating after six steps."""
    thin = {**HARD, "thickness": 0.003, "wear": {"law": "archard", "k": 5e-9}}
    return rw.simulate(
        case_of(lower__layers=[thin], mesh__geometry=geometry, time__steps=6, time__step=step,
                **{"stress__times": "all", **more})
    )  # fmt: skip


@pytest.mark.parametrize("geometry", ["fixed", "updated"])
def test_interfaces_have_no_stress_where_wear_has_come_through(geometry):
    found = worn_through(geometry, 10.0)
    left = found.layers["layer_left_lower"]
    assert 0 < np.count_nonzero(left[-1] == 0.0) < found.line.n
    r = found.stress.interfaces[0].r
    under = [int(np.abs(r - at).argmin()) for at in found.line.r]
    for state, there in zip(found.stress.states, left > 0.0, strict=True):
        known = np.isfinite(state.interfaces[0][0]).all(axis=(0, 2))
        np.testing.assert_array_equal(known[under], there)
        assert np.delete(known, under).all()


#: mm, heights on the face, inside the layer, on both sides of its end and under it
HEIGHTS = (20.0, 19.9985, 19.997, 19.997, 19.98)
GRID = {"body": "lower", "r": [28.5, 31.5], "z": [19.9985, 20.0], "n": [31, 2]}


@pytest.fixture(scope="module")
def through():
    """Points at the middles of elements and on a grid, in and under a layer that goes in places."""
    line = case_of().line
    sides = ("below", "", "above", "below", "")
    points = [
        [r, z, side] if side else [r, z]
        for r in line.r[::3].tolist()
        for z, side in zip(HEIGHTS, sides, strict=True)
    ]
    return worn_through("fixed", 10.0, stress__points=points, stress__grid=GRID)


def test_points_have_no_stress_in_layers_that_are_worn_through(through):
    """Where a layer is only partly worn, and under it, they keep theirs: the shape is unworn."""
    left = through.layers["layer_left_lower"][:, ::3]
    assert 0 < np.count_nonzero(left[-1] == 0.0) < left.shape[1]
    for row, (state, there) in enumerate(zip(through.stress.states, left > 0.0, strict=True)):
        known = np.isfinite(state.points).reshape(-1, len(HEIGHTS), 6)
        for number in (0, 1, 2):
            np.testing.assert_array_equal(known[:, number].all(axis=1), there)
        assert known[there].all()
        assert known[:, 3:].all()
        surface = np.isfinite(state.surface[0]).all(axis=1)
        np.testing.assert_array_equal(surface[::3], there)
        assert np.isfinite(state.surface[1]).all()
        under = through.line.element_at(through.stress.grid[0])
        gone = through.layers["layer_left_lower"][row] == 0.0
        on_grid = np.isfinite(state.grid).all(axis=2)
        np.testing.assert_array_equal(on_grid[:, 0], ~gone[under])
        assert not on_grid[[0, -1], 1].any()  # edges of contact
        np.testing.assert_array_equal(on_grid[1:-1, 1], ~gone[under][1:-1])


def test_the_largest_stress_beside_a_free_edge_of_an_interface_is_doubted(result):
    def doubted(of):
        return [one.text for one in of.doubts if "free edge of the interface" in one.text]

    (text,) = doubted(result)
    assert "under upper.layers[0], at r = 28.5, z = 20.2 mm" in text
    assert not doubted(rw.simulate(case_of(lower__layers=[HARD])))
    assert not doubted(rw.simulate(case_of(upper__layers=[{**ALIKE, "young": 1e5}])))


def test_exports(result, tmp_path):
    last, of = result.stress.states[-1], result.stress.interfaces
    openpyxl = pytest.importorskip("openpyxl")
    export(result, tmp_path / "a.xlsx")
    book = openpyxl.load_workbook(tmp_path / "a.xlsx")
    for body, lines, interfaces in zip(("lower", "upper"), of, last.interfaces, strict=True):
        header, *rows = book[f"interfaces of {body}"].iter_rows(values_only=True)
        assert len(rows) == 3 * 2 * len(lines.z) * len(lines.r)
        final, stress = dict(zip(header, rows[-1], strict=True)), interfaces[-1, 1, -1]
        assert final["side"] == "below"
        assert final[f"interface_stress_{body}[zz] (MPa)"] == pytest.approx(stress[2], rel=1e-14)
        assert final[f"interface_mises_{body} (MPa)"] == pytest.approx(mises(stress), rel=1e-14)
