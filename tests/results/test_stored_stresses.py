"""Stresses in results: files, interfaces, wear, geometry that follows it, doubts, exports."""

import numpy as np
import pytest
from parts import COMPONENTS, SIDES, max_shear, mises, principal
from vtkhdf import last_state

import ringwear_par as rw
from ringwear_par.results.export import export
from ringwear_par.results.key_numbers import key_numbers

BASE = {
    "mesh.contact_elements": 16, "time.steps": 6, "time.step": 30.0,
    "stress.points": [[30.0, 19.9], [30.0, 20.0, "above"], [30.0, 22.0]],
    "stress.grid": {"r": [28.0, 32.0], "z": [19.0, 21.0], "n": [9, 7]},
}  # fmt: skip
LAYERED = {
    "mesh.contact_elements": 24, "time.steps": 2, "contact.friction": 0.3,
    "stress.points": [[30.0, 19.0]], "stress.grid": None,
}  # fmt: skip
HARD = {"thickness": 0.05, "young": 1e5, "poisson": 0.3}
SOFT = {"thickness": 0.2, "young": 2e3, "poisson": 0.4}


def case_of(base=None, **more):
    changes = {key.replace("__", "."): value for key, value in more.items()}
    return rw.read_case("scripts/cases/paper.toml", {**BASE, **(base or {}), **changes})


def both_bodies(**more):
    layers = {"lower__layers": [HARD, {**SOFT, "young": 5e4}], "upper__layers": [SOFT]}
    return case_of(LAYERED, **{**layers, **more})


@pytest.fixture(scope="module")
def plain(comm):
    return rw.simulate(case_of(stress__times="all"), comm)


@pytest.fixture(scope="module")
def layered(comm):
    return rw.simulate(both_bodies(stress__times="all"), comm)


@pytest.fixture(params=["plain", "layered"])
def result(request):
    return request.getfixturevalue(request.param)


def test_variables(plain):
    data = plain.to_xarray()
    assert data.stress.point_side.values.tolist() == ["", "above", ""]
    assert data.stress.sizes == {"stress_step": 7, "point": 3, "component": 6}
    assert data.component.values.tolist() == list(COMPONENTS)
    assert data.stress_grid.dims == ("stress_step", "grid_r", "grid_z", "component")
    assert data.stress.units == "MPa"
    assert data.stress_time.values.tolist() == data.time.values.tolist()
    for name, measure in (("mises", mises), ("max_shear", max_shear), ("principal", principal)):
        np.testing.assert_array_equal(data[name], measure(data.stress.values))
    assert data.point_z.values.tolist() == [19.9, 20.0, 22.0]
    # bodies and holes of the grid, edges of contact among them
    known = np.isfinite(data.mises_grid.values[0])
    assert known[:, :3].all()
    assert known[:, 3].sum() == 7
    assert known[:, 4:].sum() == 7 * 3
    # stress follows the pressure
    for name in ("lower", "upper"):
        zz = data[f"surface_stress_{name}"].sel(component="zz").values
        np.testing.assert_allclose(zz, -data.pressure.values, rtol=1e-10)
    both = np.maximum(data.max_mises_lower, data.max_mises_upper)
    np.testing.assert_array_equal(data.max_mises, both)
    assert (data.max_mises.values >= np.nanmax(data.mises.values[:, [0, 2]], axis=1)).all()


def test_variables_of_layers(layered):
    """The largest of the layer that has the body's largest is the same."""
    data, numbers = layered.to_xarray(), layered.to_dict()["numbers"]
    assert data.interface_stress_lower.dims == (
        "stress_step", "interface_lower", "side", "interface_element_lower", "component",
    )  # fmt: skip
    assert data.side.values.tolist() == ["above", "below"]
    assert data.interface_z_lower.values == pytest.approx([19.95, 19.75])
    assert data.interface_z_upper.values == pytest.approx([20.2])
    stress = data.interface_stress_upper.values
    np.testing.assert_array_equal(data.interface_mises_upper, mises(stress))
    assert data.max_mises_lower_layers.dims == ("stress_step", "layer")
    assert data.max_mises_upper_layers.dims == ("stress_step", "layer_upper")
    for body in ("lower", "upper"):
        names = (f"max_mises_{body}{end}" for end in ("_layers", "_layer", ""))
        for own, layer, largest in zip(*(layered.stress[name] for name in names), strict=True):
            assert own.max() == own[layer] == largest
    for layer, value in enumerate(layered.stress["max_mises_lower_layers"][-1]):
        assert numbers[f"lower_mises_{layer}"] == {"value": value, "unit": "MPa"}


def test_force_and_torque_go_through_every_interface(layered):
    """Layers are free at their sides: what the contact bears must go on, however often."""
    force, torque = (layered.histories[name][-1] for name in ("force", "torque"))
    for body, end in (("lower", 20.0), ("upper", 28.5)):
        ends, line = [end], layered.stress[f"interface_r_{body}"]
        for r in line:  # of the elements, from the inner one on
            ends.append(2.0 * r - ends[-1])
        area, last = (
            np.pi * np.diff(np.square(ends)),
            layered.stress[f"interface_stress_{body}"][-1],
        )
        for stress in (side for sides in last for side in sides):
            assert -(stress[:, 2] @ area) == pytest.approx(force, rel=2e-3)
            assert stress[:, 5] @ (area * line) == pytest.approx(torque, rel=2e-3)
            assert abs(stress[:, 3] @ area) < force


def test_points_on_a_side_have_the_same(layered, comm):
    points, expected = [], []
    for body in ("lower", "upper"):
        r, z, stress = (layered.stress[f"interface_{of}_{body}"] for of in ("r", "z", "stress"))
        for number, height in enumerate(z):
            for side, word in enumerate(SIDES):
                points.append([r[3], height, word])
                expected.append(stress[-1, number, side, 3])
    found = rw.simulate(both_bodies(stress__points=points), comm).stress["stress"][-1]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_geometry_that_follows_the_wear(plain):
    """Points that wear takes away have no stress any more."""
    fixed, updated = plain.stress["stress"], case_of(stress__times="all", mesh__geometry="updated")
    moved = rw.simulate(updated).stress["stress"]
    np.testing.assert_allclose(moved[0], fixed[0], rtol=1e-9, atol=1e-9)
    assert mises(moved[-1]) == pytest.approx(mises(fixed[-1]), rel=1e-2)
    assert not np.array_equal(moved[-1], fixed[-1])
    first, *_, last = rw.simulate(case_of(
        stress__times="all", stress__points=[[30.0, 19.9999], [30.0, 19.0]], stress__grid=None,
        mesh__geometry="updated", mesh__geometry_tolerance=1e-4, wear__lower__p0=0.0,
        wear__lower__k=1e-6, time__steps=3,
    )).stress["stress"]  # fmt: skip
    assert np.isfinite(first).all()
    assert np.isfinite(last).all(axis=1).tolist() == [False, True]


# -- layers that are worn through ------------------------------------------------------------------


def worn_through(geometry, **more):
    """A thin hard coating after six steps, through in places."""
    thin = {**HARD, "thickness": 0.003, "wear": {"law": "archard", "k": 5e-9}}
    keys = {"mesh__geometry": geometry, "stress__times": "all", "time__steps": 6}
    keys |= {"lower__layers": [thin], "time__step": 10.0}
    result = rw.simulate(case_of(LAYERED, **keys, **more))
    left = result.layers["layer_left_lower"]
    assert 0 < np.count_nonzero(left[-1] == 0.0) < result.line.n
    return result, left


@pytest.mark.parametrize("geometry", ["fixed", "updated"])
def test_interfaces_have_no_stress_where_wear_has_come_through(geometry):
    found, left = worn_through(geometry)
    r = found.stress["interface_r_lower"]
    under = [int(np.abs(r - at).argmin()) for at in found.line.r]
    for stress, there in zip(found.stress["interface_stress_lower"], left > 0.0, strict=True):
        known = np.isfinite(stress[0]).all(axis=(0, 2))
        np.testing.assert_array_equal(known[under], there)
        assert np.delete(known, under).all()


def test_points_have_no_stress_in_layers_that_are_worn_through():
    """Where a layer is only partly worn, and under it, they keep theirs: the shape is unworn."""
    # mm, on the face, inside the layer, on both sides of its end and under it
    heights = [[20.0, "below"], [19.9985], [19.997, "above"], [19.997, "below"], [19.98]]
    points = [[r, *height] for r in case_of(LAYERED).line.r[::3].tolist() for height in heights]
    grid = {"body": "lower", "r": [28.5, 31.5], "z": [19.9985, 20.0], "n": [31, 2]}
    found, left = worn_through("fixed", stress__points=points, stress__grid=grid)
    under = found.line.element_at(found.stress["grid_r"])
    names = ("stress", "stress_grid", "surface_stress_lower", "surface_stress_upper")
    states = zip(*(np.isfinite(found.stress[name]) for name in names), left > 0.0, strict=True)
    for at_points, at_grid, lower, upper, there in states:
        known = at_points.reshape(-1, len(heights), 6)
        for number in (0, 1, 2):
            np.testing.assert_array_equal(known[:, number].all(axis=1), there[::3])
        assert known[there[::3]].all()
        assert known[:, 3:].all()
        np.testing.assert_array_equal(lower.all(axis=1), there)
        assert upper.all()
        on_grid = at_grid.all(axis=2)
        np.testing.assert_array_equal(on_grid[:, 0], there[under])
        assert not on_grid[[0, -1], 1].any()  # edges of contact
        np.testing.assert_array_equal(on_grid[1:-1, 1], there[under][1:-1])


@pytest.mark.parametrize("geometry", ["fixed", "updated"])
def test_layers_that_are_gone_have_no_largest_stress(geometry):
    film = {"thickness": 5e-4, "young": 1e4, "poisson": 0.3, "wear": {"law": "archard", "k": 1e-6}}
    changes = {"upper__layers": [film], "mesh__geometry": geometry, "stress__exclude": 0.05}
    result = rw.simulate(case_of(**changes))
    assert result.layers["share_through_upper"][-1] == 1.0
    ((gone, left),) = result.stress["max_mises_upper_layers"]
    assert np.isnan(gone)
    numbers = result.to_dict()["numbers"]
    assert [numbers[f"upper_mises_{layer}"]["value"] for layer in (0, 1)] == [None, left]
    assert "nan" not in result.summary()


# -- where stress is infinite, and where it is known -----------------------------------------------


def test_the_largest_stress_at_an_edge_is_doubted(layered):
    unworn = rw.simulate(case_of(stress__times="last", time__steps=1, time__step=1e-6))
    (lower,) = (number for number in key_numbers(unworn) if number.name == "lower_mises")
    assert lower.value == unworn.stress["max_mises_lower"][-1]
    assert any("stress.exclude" in doubt.text for doubt in unworn.doubts)
    # beside a free edge of an interface between two materials, too
    (text,) = [doubt.text for doubt in layered.doubts if "free edge" in doubt.text]
    assert "under upper.layers[0], at r = 28.5, z = 20.2 mm" in text
    alike = {"thickness": 0.3, "young": 1e5, "poisson": 0.3}
    for layers in ({"lower__layers": [HARD]}, {"upper__layers": [alike]}):
        doubts = rw.simulate(case_of(LAYERED, **layers)).doubts
        assert not any("free edge" in doubt.text for doubt in doubts)


def test_hertz_like_crown_has_its_largest_stress_inside():
    """A crowned ring: the largest von Mises lies under the contact, no edge is in doubt."""
    result = rw.simulate(case_of(
        upper__profile={"crown": 50.0}, load__force=2000.0, load__pressure=None, stress__grid=None,
        stress__points=[[30.0, 19.0]], contact__friction=0.0, mesh__contact=[29.4, 30.6],
        mesh__contact_elements=48, time__steps=1, time__step=1e-6, mesh__grading=1.0,
    ))  # fmt: skip
    highest, height = (result.stress[f"max_mises_lower{end}"][-1] for end in ("", "_z"))
    p = result.profiles["pressure"][-1]
    a = 2.0 * 2000.0 / (2.0 * np.pi * 30.0) / (np.pi * p.max())
    # a line contact: 0.558 p_max at 0.704 a for nu = 0.3
    assert highest == pytest.approx(0.558 * p.max(), rel=0.02)
    assert 20.0 - height == pytest.approx(0.704 * a, rel=0.05)
    assert not any("stress.exclude" in doubt.text for doubt in result.doubts)


def test_stresses_beside_the_contact_converge(comm):
    """The free face has elements for them, which pressures would not need."""
    beside = [[31.8, 19.9], [31.7, 19.95], [28.2, 19.9], [28.45, 19.95], [28.6, 19.9]]
    found = {}
    for n in (64, 128):
        changes = {"mesh.contact_elements": n, "time.steps": 1, "time.step": 1e-6}
        case = rw.read_case("scripts/cases/paper.toml", {**changes, "stress.points": beside})
        found[n] = mises(rw.simulate(case, comm).stress["stress"][-1])
    np.testing.assert_allclose(found[64], found[128], rtol=0.01)


def test_exports(plain, layered, tmp_path):
    grid = plain.stress["stress_grid"][-1]
    known = np.isfinite(grid).all(axis=-1)
    export(plain, tmp_path / "a.vtkhdf")
    data = last_state(tmp_path / "a.vtkhdf")
    assert len(data["points"]) == known.sum()
    assert data["mises"] == pytest.approx(mises(grid[known]))
    assert data["stress_tz"] == pytest.approx(grid[known][:, 5])
    # quadrangles of the grid, none across edges, where nothing is known
    corners = data["points"][data["cells"]]
    assert np.ptp(corners[..., 0], axis=1) == pytest.approx(0.5)
    assert np.ptp(corners[..., 2], axis=1) == pytest.approx(1.0 / 3.0)
    openpyxl = pytest.importorskip("openpyxl")
    export(layered, tmp_path / "a.xlsx")
    book = openpyxl.load_workbook(tmp_path / "a.xlsx")
    for name in ("lower", "upper"):
        header, *rows = book[f"interfaces of {name}"].iter_rows(values_only=True)
        last = dict(zip(header, rows[-1], strict=True))
        stress = layered.stress[f"interface_stress_{name}"][-1]
        assert len(rows) == 3 * stress[..., 0].size
        assert last["side"] == "below"
        for column, value in (("stress_{}[zz]", stress[-1, 1, -1, 2]),
                              ("mises_{}", mises(stress[-1, 1, -1]))):  # fmt: skip
            found = last[f"interface_{column.format(name)} (MPa)"]
            assert found == pytest.approx(value, rel=1e-14)
