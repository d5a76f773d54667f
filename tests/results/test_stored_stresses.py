"""Stresses in results: files, geometry that follows the wear, doubts, pictures."""

import numpy as np
import pytest
from last_states import with_last_pressure
from parts import COMPONENTS, max_shear, mises, principal
from vtkhdf import last_state

import ringwear_par as rw
from ringwear_par.results.export import export
from ringwear_par.results.key_numbers import key_numbers

BASE = {
    "mesh.contact_elements": 16, "time.steps": 6, "time.step": 30.0,
    "stress.points": [[30.0, 19.9], [30.0, 20.0, "above"], [30.0, 22.0]],
    "stress.grid": {"r": [28.0, 32.0], "z": [19.0, 21.0], "n": [9, 7]},
}  # fmt: skip


def case_of(**more):
    changes = {key.replace("__", "."): value for key, value in more.items()}
    return rw.read_case("scripts/cases/paper.toml", {**BASE, **changes})


def same(one, other):
    """The stresses of two results are the same."""
    assert one.stress.sides == other.stress.sides
    for a, b in zip(one.stress.states, other.stress.states, strict=True):
        assert (a.step, a.time, a.largest) == (b.step, b.time, b.largest)
        for name in ("points", "grid", "surface"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        for name in ("interfaces", "layers"):
            for one_body, other_body in zip(getattr(a, name), getattr(b, name), strict=True):
                np.testing.assert_array_equal(one_body, other_body)


def test_variables_and_file(tmp_path):
    result = rw.simulate(case_of(stress__times="all"))
    path = tmp_path / "run.h5"
    result.save(path)
    same(rw.open_result(path), result)
    data = result.to_xarray()
    assert data.stress.point_side.values.tolist() == ["", "above", ""]
    assert data.stress.sizes == {"stress_step": 7, "point": 3, "component": 6}
    assert data.component.values.tolist() == list(COMPONENTS)
    assert data.stress_grid.dims == ("stress_step", "grid_r", "grid_z", "component")
    assert data.stress.units == "MPa"
    assert data.stress_time.values.tolist() == data.time.values.tolist()
    np.testing.assert_array_equal(data.mises, mises(data.stress.values))
    np.testing.assert_array_equal(data.max_shear, max_shear(data.stress.values))
    np.testing.assert_array_equal(data.principal, principal(data.stress.values))
    assert data.point_z.values.tolist() == [19.9, 20.0, 22.0]
    # bodies and holes of the grid, edges of contact among them
    known = np.isfinite(data.mises_grid.values[0])
    assert known[:, :3].all()
    assert known[:, 3].sum() == 7
    assert known[:, 4:].sum() == 7 * 3
    # stress follows the pressure
    pressure = data.pressure.values
    for name in ("lower", "upper"):
        zz = data[f"surface_stress_{name}"].sel(component="zz").values
        np.testing.assert_allclose(zz, -pressure, rtol=1e-10)
    both = np.maximum(data.max_mises_lower, data.max_mises_upper)
    np.testing.assert_array_equal(data.max_mises, both)
    assert (data.max_mises.values >= np.nanmax(data.mises.values[:, [0, 2]], axis=1)).all()


@pytest.mark.parametrize("times", ["last", [0.0, 60.0]])
def test_many_cases_have_the_stresses_of_single_ones(times, comm):
    case = case_of(stress__times=times, output__times=[10.0, 60.0], contact__friction=0.2)
    changes = [{"load.pressure": 50.0}, {"wear.lower.k": 2e-7}, {"upper.young": 5e4},
               {"mesh.geometry": "updated", "mesh.geometry_tolerance": 1.0}]  # fmt: skip
    cases = [case.replace(change) for change in changes]
    for each, mine in zip(cases, rw.simulate_all(cases, comm), strict=True):
        single = rw.simulate(each, comm)
        assert [d.code for d in mine.doubts] == [d.code for d in single.doubts]
        for a, b in zip(mine.stress.states, single.stress.states, strict=True):
            assert (a.step, a.time) == (b.step, pytest.approx(b.time, rel=1e-12))
            np.testing.assert_allclose(a.points, b.points, rtol=0, atol=2e-4 * 50.0)
            np.testing.assert_allclose(a.grid, b.grid, rtol=0, atol=2e-4 * 50.0)


def test_geometry_that_follows_the_wear():
    fixed = rw.simulate(case_of(stress__times="all"))
    moved = rw.simulate(case_of(stress__times="all", mesh__geometry="updated"))
    first, last = moved.stress.states[0], moved.stress.states[-1]
    np.testing.assert_allclose(first.points, fixed.stress.states[0].points, rtol=1e-9, atol=1e-9)
    assert mises(last.points) == pytest.approx(mises(fixed.stress.states[-1].points), rel=1e-2)
    assert not np.array_equal(last.points, fixed.stress.states[-1].points)


def test_points_that_wear_takes_away_have_no_stress():
    case = case_of(
        stress__times="all", stress__points=[[30.0, 19.9999], [30.0, 19.0]], stress__grid=None,
        mesh__geometry="updated", mesh__geometry_tolerance=1e-4, wear__lower__p0=0.0,
        wear__lower__k=1e-6, time__steps=3,
    )  # fmt: skip
    result = rw.simulate(case)
    assert np.isfinite(result.stress.states[0].points).all()
    assert np.isnan(result.stress.states[-1].points[0]).all()
    assert np.isfinite(result.stress.states[-1].points[1]).all()


def test_the_largest_stress_at_an_edge_is_doubted():
    unworn = rw.simulate(case_of(stress__times="last", time__steps=1, time__step=1e-6))
    largest, _ = unworn.stress.states[-1].largest

    def lower(of):
        (found,) = (number for number in key_numbers(of) if number.name == "lower_mises")
        return found

    assert lower(unworn).value == largest.mises
    assert any("stress.exclude" in doubt.text for doubt in unworn.doubts)
    # contact that ends at the radius of the largest stress of lower has an edge element there
    assert "edge of contact" not in lower(unworn).note
    p = unworn.checkpoint.last.pressure.copy()
    p[unworn.line.element_at(np.array([largest.r]))[0] + 1 :] = 0.0
    assert "edge of contact" in lower(with_last_pressure(unworn, p)).note


def test_hertz_like_crown_has_its_largest_stress_inside():
    """A crowned ring: the largest von Mises lies under the contact, no edge is in doubt."""
    result = rw.simulate(case_of(
        upper__profile={"crown": 50.0}, load__force=2000.0, load__pressure=None, stress__grid=None,
        stress__points=[[30.0, 19.0]], contact__friction=0.0, mesh__contact=[29.4, 30.6],
        mesh__contact_elements=48, time__steps=1, time__step=1e-6, mesh__grading=1.0,
    ))  # fmt: skip
    lower, _ = result.stress.states[-1].largest
    p = result.profiles["pressure"][-1]
    a = 2.0 * 2000.0 / (2.0 * np.pi * 30.0) / (np.pi * p.max())
    # a line contact: 0.558 p_max at 0.704 a for nu = 0.3
    assert lower.mises == pytest.approx(0.558 * p.max(), rel=0.02)
    assert 20.0 - lower.z == pytest.approx(0.704 * a, rel=0.05)
    assert not any("stress.exclude" in doubt.text for doubt in result.doubts)


@pytest.fixture(scope="module")
def stored(tmp_path_factory, comm):
    path = tmp_path_factory.mktemp("stresses") / "run.h5"
    rw.simulate(case_of(stress__times="all", time__steps=4), comm).save(path)
    return path


def test_exports(stored, tmp_path):
    state = rw.open_result(stored).stress.states[-1]
    known = np.isfinite(state.grid).all(axis=-1)
    export(stored, tmp_path / "a.vtkhdf")
    data = last_state(tmp_path / "a.vtkhdf")
    assert len(data["points"]) == known.sum()
    assert data["mises"] == pytest.approx(mises(state.grid[known]))
    assert data["stress_tz"] == pytest.approx(state.grid[known][:, 5])
    # quadrangles of the grid, none across edges, where nothing is known
    corners = data["points"][data["cells"]]
    assert np.ptp(corners[..., 0], axis=1) == pytest.approx(0.5)
    assert np.ptp(corners[..., 2], axis=1) == pytest.approx(1.0 / 3.0)
    openpyxl = pytest.importorskip("openpyxl")
    export(stored, tmp_path / "a.xlsx")
    header, *rows = openpyxl.load_workbook(tmp_path / "a.xlsx")["stress at points"].iter_rows(
        values_only=True
    )
    first = header.index("stress[rr] (MPa)")
    assert len(rows) == 5 * 3
    assert rows[-1][first : first + 6] == pytest.approx(state.points[-1])


def test_stresses_beside_the_contact_converge(comm):
    """The free face has elements for them, which pressures would not need."""
    beside = [[31.8, 19.9], [31.7, 19.95], [28.2, 19.9], [28.45, 19.95], [28.6, 19.9]]
    found = {}
    for n in (64, 128):
        changes = {"mesh.contact_elements": n, "time.steps": 1, "time.step": 1e-6}
        case = rw.read_case("scripts/cases/paper.toml", {**changes, "stress.points": beside})
        found[n] = mises(rw.simulate(case, comm).stress.states[-1].points)
    np.testing.assert_allclose(found[64], found[128], rtol=0.01)


def test_the_largest_of_each_layer(tmp_path):
    """That of the layer that has the largest is the body's; layers of both bodies are apart."""
    layer = {"thickness": 0.05, "young": 2e5, "poisson": 0.3}
    soft = {"thickness": 0.1, "young": 5e4, "poisson": 0.3}
    result = rw.simulate(
        case_of(stress__times="all", lower__layers=[layer, soft], upper__layers=[soft])
    )
    for state in result.stress.states:
        for own, largest in zip(state.layers, state.largest, strict=True):
            assert own.max() == own[largest.layer] == largest.mises
    result.save(tmp_path / "run.h5")
    same(rw.open_result(tmp_path / "run.h5"), result)
    data, numbers = result.to_xarray(), result.to_dict()["numbers"]
    assert data.max_mises_lower_layers.dims == ("stress_step", "layer")
    assert data.max_mises_upper_layers.dims == ("stress_step", "layer_upper")
    for layer, value in enumerate(result.stress.states[-1].layers[0]):
        assert numbers[f"lower_mises_{layer}"] == {"value": value, "unit": "MPa"}


@pytest.mark.parametrize("geometry", ["fixed", "updated"])
def test_layers_that_are_gone_have_no_largest_stress(geometry):
    film = {"thickness": 5e-4, "young": 1e4, "poisson": 0.3, "wear": {"law": "archard", "k": 1e-6}}
    changes = {"upper__layers": [film], "mesh__geometry": geometry, "stress__exclude": 0.05}
    result = rw.simulate(case_of(**changes))
    assert result.layers["share_through_upper"][-1] == 1.0
    ((gone, left),) = (state.layers[1] for state in result.stress.states)
    assert np.isnan(gone)
    numbers = result.to_dict()["numbers"]
    assert [numbers[f"upper_mises_{layer}"]["value"] for layer in (0, 1)] == [None, left]
    assert "nan" not in result.summary()
