"""Stresses in results: files, ranks, geometry that follows the wear, the summary."""

import csv

import numpy as np
import pytest
from last_states import with_last_pressure
from vtkhdf import last_state

import ringwear_par as rw
from ringwear_par.elasticity.stress.fields import COMPONENTS, max_shear, mises, principal
from ringwear_par.elasticity.stress.recovery import StressRecovery
from ringwear_par.results.storage.export import export

BASE = {
    "mesh.contact_elements": 16, "time.steps": 6, "time.step": 30.0,
    "stress.points": [[30.0, 19.9], [30.0, 20.0, "above"], [30.0, 22.0]],
    "stress.grid": {"r": [28.0, 32.0], "z": [19.0, 21.0], "n": [9, 7]},
}  # fmt: skip


def case_of(**more):
    changes = {key.replace("__", "."): value for key, value in more.items()}
    return rw.read_case("scripts/cases/paper.toml", {**BASE, **changes})


def same(one, other):
    assert len(one.stress.states) == len(other.stress.states)
    assert one.stress.sides == other.stress.sides
    for a, b in zip(one.stress.states, other.stress.states, strict=True):
        assert (a.step, a.time) == (b.step, b.time)
        np.testing.assert_array_equal(a.points, b.points)
        np.testing.assert_array_equal(a.grid, b.grid)
        np.testing.assert_array_equal(a.surface, b.surface)
        assert a.largest == b.largest
        for one_body, other_body in zip(a.interfaces, b.interfaces, strict=True):
            np.testing.assert_array_equal(one_body, other_body)
        np.testing.assert_array_equal(np.concatenate(a.layers), np.concatenate(b.layers))


def test_variables_and_file(tmp_path):
    import xarray

    result = rw.simulate(case_of(stress__times="all"))
    path = tmp_path / "run.h5"
    result.save(path)
    same(rw.open_result(path), result)
    data = result.to_xarray()
    with xarray.open_dataset(path, engine="h5netcdf") as stored:
        xarray.testing.assert_identical(
            stored[["stress", "mises_grid"]], data[["stress", "mises_grid"]]
        )
        assert stored.stress.point_side.values.tolist() == ["", "above", ""]
        assert stored.stress.sizes == {"stress_step": 7, "point": 3, "component": 6}
        assert stored.component.values.tolist() == list(COMPONENTS)
        assert stored.stress_grid.dims == ("stress_step", "grid_r", "grid_z", "component")
        assert stored.stress.units == "MPa"
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
def test_many_cases_share_what_is_integrated(times, comm, monkeypatch):
    """Same bits in whatever company; those of single runs to round-off; one of them stays alone."""
    made, integrated = [], StressRecovery._integrated
    monkeypatch.setattr(
        StressRecovery, "_integrated", lambda *words: made.append(1) or integrated(*words)
    )
    case = case_of(stress__times=times, output__times=[10.0, 60.0], contact__friction=0.2)
    changes = [{"load.pressure": 50.0}, {"wear.lower.k": 2e-7}, {"upper.young": 5e4},
               {"mesh.geometry": "updated", "mesh.geometry_tolerance": 1.0}]  # fmt: skip
    cases = [case.replace(change) for change in changes]
    found = rw.simulate_all(cases, comm)
    assert len(made) <= 2  # the mesh of one follows the wear
    for mine, other in zip(found, rw.simulate_all(cases, comm, batch=1), strict=True):
        same(mine, other)
        assert mine.doubts == other.doubts
    for each, mine in zip(cases, found, strict=True):
        single = rw.simulate(each, comm)
        assert mine.doubts == single.doubts
        for a, b in zip(mine.stress.states, single.stress.states, strict=True):
            assert (a.step, a.time) == (b.step, pytest.approx(b.time, rel=1e-12))
            np.testing.assert_allclose(a.points, b.points, rtol=1e-8, atol=1e-8)
            np.testing.assert_allclose(a.grid, b.grid, rtol=1e-8, atol=1e-8)


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


def test_summary_and_doubt():
    unworn = rw.simulate(case_of(stress__times="last", time__steps=1, time__step=1e-6))
    (line,) = [
        line for line in unworn.summary(verbose=True).splitlines() if line.startswith("largest von")
    ]
    state = unworn.stress.states[-1]
    assert f"lower {state.largest[0].mises:.5g} MPa (at r = " in line
    assert any("stress.exclude" in doubt.text for doubt in unworn.doubts)
    # contact that ends at the radius of the largest stress of lower has an edge element there
    assert "edge of contact" not in line
    p = unworn.checkpoint.state.contact.pressure.copy()
    p[unworn.line.element_at(np.array([state.largest[0].r]))[0] + 1 :] = 0.0
    (line,) = (text for text in with_last_pressure(unworn, p).summary(verbose=True).splitlines()
               if text.startswith("largest von"))  # fmt: skip
    assert "edge of contact" in line.split("upper")[0]
    worn = rw.simulate(case_of(wear__lower__p0=0.0, wear__upper__law="archard", wear__upper__k=1e-7,
                               time__steps=40, time__step=30.0, stress__exclude=0.0))  # fmt: skip
    assert not any("stress.exclude" in doubt.text for doubt in worn.doubts)


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


def test_pictures_show_what_is_stored(stored, tmp_path):
    from ringwear_par.studies.pictures.plot import plot_stored

    result = rw.open_result(stored)
    r, z = result.stress.grid
    figure = rw.plot(result, ["stress", "depth", "mises"], times="0, 120")
    first, bar, last, other, depth, largest = figure.axes
    assert bar.get_ylabel() == other.get_ylabel() == "von Mises stress (MPa)"
    # one scale, the sections around the maps, the worn face in the second only
    scales = {axes.collections[0].norm.vmax for axes in (first, last)}
    assert len(scales) == 1
    assert [len(axes.patches) for axes in (first, last)] == [2, 2]
    assert [len(axes.lines) for axes in (first, last)] == [0, 1]
    legend = last.get_legend() or last.figure.legends[0]
    assert any("worn face of lower" in text.get_text() for text in legend.get_texts())
    assert first.get_xlim() == (28.0, 32.0)
    for line, state in zip(depth.lines, (result.stress.states[i] for i in (0, -1)), strict=False):
        values = mises(state.grid[int(np.abs(r - 30.0).argmin())])
        drawn = line.get_xdata()
        assert drawn[np.isfinite(drawn)] == pytest.approx(values[np.isfinite(values)])
        assert len(line.get_ydata()) == len(z) + 2  # cut at both faces
    lower = [state.largest[0].mises for state in result.stress.states]
    assert largest.lines[0].get_ydata() == pytest.approx(lower)
    # side by side, a map with its bar of colours is about as wide as the others
    figure = rw.plot(result, "stress,depth,mises")
    figure.draw_without_rendering()
    widths = [figure.axes[i].get_position().width for i in (0, 2, 3)]
    assert min(widths) > 0.8 * max(widths)
    plot_stored([stored], tmp_path / "a.png", "stress,depth,mises,wear")
    assert (tmp_path / "a.png").stat().st_size > 3000


def test_exports(stored, tmp_path):

    result = rw.open_result(stored)
    state = result.stress.states[-1]
    known = np.isfinite(state.grid).all(axis=-1)
    said = export(stored, tmp_path / "a.vtkhdf", stress=True)
    assert said.endswith("a.vtkhdf: stress, 5 states from 0 to 120 s")
    data = last_state(tmp_path / "a.vtkhdf")
    assert len(data["points"]) == known.sum()
    assert data["mises"] == pytest.approx(mises(state.grid[known]))
    assert data["stress_tz"] == pytest.approx(state.grid[known][:, 5])
    # quadrangles of the grid, none across edges, where nothing is known
    corners = data["points"][data["cells"]]
    assert np.ptp(corners[..., 0], axis=1) == pytest.approx(0.5)
    assert np.ptp(corners[..., 2], axis=1) == pytest.approx(1.0 / 3.0)
    early = last_state(tmp_path / "a.vtkhdf", 0)
    assert early["mises"] == pytest.approx(mises(result.stress.states[0].grid[known]))
    export(stored, tmp_path / "a.csv", stress=True)
    with (tmp_path / "a.csv").open() as file:
        header, *rows = csv.reader(file)
    assert header[:5] == ["step", "time (s)", "r (mm)", "z (mm)", "rr (MPa)"]
    assert header[-1] == "side"
    assert len(rows) == 5 * 3
    assert list(map(float, rows[-1][4:10])) == state.points[-1].tolist()


def test_the_page_of_a_run_has_them(stored, tmp_path):
    page = tmp_path / "run.html"
    rw.report(stored, page)
    text = page.read_text()
    section = text[text.index(">Stress inside</h2>") :]
    assert "data:image/png;base64," in section
    state = rw.open_result(stored).stress.states[-1]
    assert f">{state.largest[0].mises:.5g}</td>" in section


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
    read, data = rw.open_result(tmp_path / "run.h5"), result.to_xarray()
    same(read, result)
    assert read.stress.layers == result.stress.layers == (3, 2)
    assert data.max_mises_lower_layers.dims == ("stress_step", "layer")
    assert data.max_mises_upper_layers.dims == ("stress_step", "layer_upper")
    names = ("layer 0 of lower", "layer 1 of lower", "lower itself")
    values = zip(names, result.stress.states[-1].layers[0], strict=True)
    assert ", ".join(f"{name} {value:.5g} MPa" for name, value in values) in result.summary(
        verbose=True
    )


@pytest.mark.parametrize("geometry", ["fixed", "updated"])
def test_layers_that_are_gone_have_no_largest_stress(geometry, tmp_path):
    """Of the body's own material and worn through everywhere: said in words."""
    film = {"thickness": 5e-4, "young": 1e4, "poisson": 0.3, "wear": {"law": "archard", "k": 1e-6}}
    changes = {"upper__layers": [film], "mesh__geometry": geometry, "stress__exclude": 0.05}
    result = rw.simulate(case_of(**changes))
    assert result.layers["share_through_upper"][-1] == 1.0
    ((gone, left),) = (state.layers[1] for state in result.stress.states)
    assert np.isnan(gone)
    assert "layer 0 of upper none" in result.summary(verbose=True)
    assert f"upper itself {left:.5g} MPa" in result.summary(verbose=True)
    assert "nan" not in result.summary(verbose=True)
    result.save(tmp_path / "run.h5")
    assert rw.open_result(tmp_path / "run.h5").summary(verbose=True) == result.summary(verbose=True)
