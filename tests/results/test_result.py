"""Results: the dataset of their file, bit for bit; saved, opened; their numbers and summary."""

import json
import pickle

import numpy as np
import pytest
import xarray
from mpi4py import MPI
from paths import CASES, PAPER, ROOT
from stored import assert_same, attributes

import ringwear_par as rw
from ringwear_par.results.files import open_result
from ringwear_par.results.key_numbers import check_numbers, key_numbers, schedule_of
from ringwear_par.results.variables import EDGE_ELEMENT, FIELDS, VARIABLES, axis

SMALL = ["mesh.contact_elements=16", "time.steps=20"]
SHORT = ["mesh.contact_elements=16", "time.end=20", "output.times=[5, 10]"]


@pytest.fixture
def computed(tmp_path, comm):
    """Function that computes a case and returns the file of its result, and the result."""

    def computed(case, words):
        path, result = tmp_path / "run.h5", rw.simulate(rw.read_case(CASES / case, words), comm)
        result.save(path)
        return path, result

    return computed


@pytest.mark.parametrize(
    ("case", "words"),
    [
        ("paper.toml", SMALL),
        ("paper.toml", [*SMALL, "output.every=8", "output.fields=['gap']"]),
        ("paper.toml", [*SMALL, "output.profiles=last"]),
        ("fields.toml", SHORT),
        ("wear_through.toml", [SMALL[0], "output.profiles=last"]),
    ],
)
def test_the_dataset_is_that_of_the_file(computed, case, words):
    path, result = computed(case, words)
    with xarray.open_dataset(path, engine="h5netcdf") as stored:
        stored.load()
    dataset = result.to_xarray()
    xarray.testing.assert_identical(stored, dataset)
    xarray.testing.assert_identical(stored, open_result(path).to_xarray())
    fields = {**FIELDS, EDGE_ELEMENT.name: EDGE_ELEMENT}
    for name, values in stored.variables.items():
        variable = VARIABLES.get(name, axis(name))
        assert values.dtype == variable.dtype == dataset.variables[name].dtype
        assert values.attrs["units"] == variable.unit
        last = "output.profiles=last" in words and name in fields
        assert values.dims == (variable.at_last_step() if last else variable).dimensions
    of_layers = {"layer", "interface_lower"}
    assert set(stored.coords) - of_layers == {"step", "element", "time", "r", "width"}
    if "output.every=8" in words:  # and fields
        assert stored.step.values.tolist() == stored.time.values.tolist() == [0, 8, 16, 20]
        assert "pressure" not in stored
        assert stored.contact_iterations.sum() >= 20


@pytest.mark.parametrize("extra", [[], ["mesh.geometry=updated", "wear.lower.k=1e-6"]])
def test_saved_and_opened_it_is_the_same(computed, tmp_path, extra):
    """Sent to another process, too."""
    path, result = computed("fields.toml", [*SHORT, *extra])
    again, copy = open_result(str(path)), tmp_path / "copy.h5"
    again.save(str(copy))
    assert_same(path, copy)
    assert (again.last_state.meshed is not None) == bool(extra)
    np.testing.assert_equal(attributes(copy), attributes(path))
    np.testing.assert_array_equal(again.line.edges, result.line.edges)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["copy.h5", "run.h5"]
    assert again.balances == result.balances
    assert 0.0 < result.balances["torque"] < 0.01
    assert result.balances["force"] < 1e-10
    assert pickle.loads(pickle.dumps(result)).to_dict() == again.to_dict()
    assert json.loads(json.dumps(again.to_dict()))["numbers"] == {
        number.name: {"value": number.value if number.known else None, "unit": number.unit}
        for number in (*key_numbers(again), *check_numbers(again))
    }


def test_all_groups_open_as_a_tree(computed):
    """Also with warnings as errors, so without axes that have no name."""
    path, _ = computed("fields.toml", SHORT)
    with xarray.open_datatree(path, engine="h5netcdf") as tree:
        assert {"boundary", "checkpoint", "line"} == set(tree.children)
        assert tree["line/edges"].size == 17
        for body in ("lower", "upper"):
            group = tree[f"boundary/{body}"]
            assert group.sizes["boundary_node"] == 2 * group.sizes["boundary_element"]  # closed
            assert not {"step", "element"} & {d for v in group.data_vars for d in group[v].dims}
            assert group["nodes"].dims == ("boundary_step", "boundary_node", "plane")
            assert group["traction"].dims == ("boundary_step", "boundary_element", "direction")


def test_elements_beside_an_edge_of_contact_are_marked(computed):
    """The last closed and the first open one; none where contact reaches the line's end."""
    few = ["mesh.contact_elements=24", "time.steps=3"]
    data = computed("chamfer.toml", few)[1].to_xarray()
    for p, row in zip(data.pressure.values, data.edge_element.values, strict=True):
        first, *_, last = np.flatnonzero(p > 0.0)
        assert 0 < first < last < 23
        assert np.flatnonzero(row).tolist() == [first - 1, first, last, last + 1]
    marked = computed("paper.toml", [*few, "output.profiles=last"])[1].to_xarray().edge_element
    assert marked.dims == ("element",)
    assert not marked.any()


def test_key_numbers_do_not_depend_on_where_elements_are():
    """Contact on 3 of the 5 mm of a crown: means are those of the nominal annulus all the same."""
    changes = {"load.force": None, "load.pressure": 1.0, "mesh.contact_elements": 48,
               "time.end": 20.0}  # fmt: skip
    case = rw.read_case(CASES / "crown.toml", changes)
    whole, cut = (
        {n.name: n.value for n in key_numbers(rw.simulate(one, MPI.COMM_SELF))}
        for one in (case, case.replace({"mesh.contact": [11.0, 14.0]}))
    )
    assert whole["mean_pressure"] == pytest.approx(1.0, rel=1e-9)
    for name in ("mean_pressure", "speed", "p_v", "distance"):
        assert cut[name] == pytest.approx(whole[name], rel=1e-9)
    assert cut["upper_mean_rate"] == pytest.approx(whole["upper_mean_rate"], rel=5e-3)
    assert "worn_off" not in cut  # the approach has closed gaps too


def test_the_elastic_part_of_a_penetration_is_that_of_the_load():
    """Twice the load at an instant presses as much deeper as the elastic part says."""
    load = [[0.0, 20.0], [10.0, 20.0], [10.001, 40.0]]
    changes = {"load.pressure": load, "mesh.contact_elements": 16, "time.steps": 10}
    changes |= {"time.step": 1.0, "wear.lower.p0": 0.0}
    before, after = (
        rw.simulate(rw.read_case(PAPER, {**changes, **more}), MPI.COMM_SELF)
        for more in ({}, {"time.step": 1.001})
    )
    pressed = (after.histories["approach"] - before.histories["approach"])[-1]
    numbers = (run.to_dict()["numbers"]["elastic"]["value"] for run in (after, before))
    elastic = np.subtract(*numbers)
    assert elastic == pytest.approx(1e3 * pressed, rel=0.02)
    assert elastic > 1.0  # um


def test_tables_of_many_points_are_stored(tmp_path):
    """HDF5 has room for 64 kB in an attribute that is no text."""
    t = np.linspace(0.0, 20.0, 9000)
    tables = {
        key: np.column_stack([t, size * (1.0 + 1e-3 * t)]).tolist()
        for key, size in (("contact.friction", 0.1), ("load.pressure", 50.0), ("load.omega", 3.5))
    }
    case = rw.read_case(PAPER, {"mesh.contact_elements": 12, "time.steps": 4, **tables})
    rw.simulate(case).save(tmp_path / "run.h5")
    stored = open_result(tmp_path / "run.h5")
    assert schedule_of(stored.attributes, "friction") == case.friction
    assert stored.case == case.text


def test_notebooks_show_outcomes():
    """Their numbers and one picture; of a study what it varies."""
    keys = {"mesh.contact_elements": 8, "time.steps": 2}
    result = rw.simulate(rw.read_case(PAPER, keys))
    measured = rw.measure(ROOT / "scripts/measure/measure.toml")
    for outcome, words in ((result, ("penetration", "torque")), (measured, ("wear rate",))):
        html = outcome._repr_html_()
        assert html.count('<img src="data:image/png;base64,') == 1
        assert all(word in html for word in words)
    study = rw.read_study(CASES / "study.toml")._repr_html_()
    assert study.count("<svg") == 1
    assert "0, 20, 40" in study
