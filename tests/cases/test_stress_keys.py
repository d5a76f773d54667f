"""[stress] in case files: points, grids, sides, units, and a sentence for everything wrong."""

import numpy as np
import pytest
from paths import PAPER

from ringwear_par.cases.case import Grid
from ringwear_par.cases.files.reading import parse_case
from ringwear_par.cases.stress_points import grid_bodies, point_bodies
from ringwear_par.errors import InputError

TEXT = PAPER.read_text()


def case_of(stress, overrides=()):
    return parse_case(f"{TEXT}\n[stress]\n{stress}\n", "case.toml", overrides)


def faults(stress, overrides=()):
    with pytest.raises(InputError) as caught:
        case_of(stress, overrides)
    return list(caught.value.faults)


def test_absent_is_none():
    assert parse_case(TEXT, "case.toml").stress is None


def test_points_grid_times():
    case = case_of(
        'points = [[30.0, 19.95], ["3 cm", "25000 um"], [30, 20, "above"], [30, 20, "below"]]\n'
        'grid = { body = "lower", r = ["28 mm", 32.0], z = [18.0, 20.0], n = [3, 2] }\n'
        'times = ["1 min", 120]\nexclude = "50 um"'
    )
    stress = case.stress
    assert stress.points == (
        (30.0, 19.95, ""), (30.0, 25.0, ""), (30.0, 20.0, "above"), (30.0, 20.0, "below"),
    )  # fmt: skip
    assert point_bodies(case) == [0, 1, 1, 0]
    assert stress.grid == Grid("lower", (28.0, 32.0), (18.0, 20.0), (3, 2))
    assert (stress.times, stress.exclude) == ((60.0, 120.0), 0.05)
    assert parse_case(case.text, "stored").stress == stress
    usual = case_of('times = "all"').stress
    assert (usual.points, usual.grid, usual.exclude) == ((), None, 0.1)


def test_overrides_of_single_entries():
    case = case_of("grid = { r = [28, 32], z = [18, 22], n = [30, 20] }", ["stress.grid.n=[3,5]"])
    assert case.stress.grid == Grid("both", (28.0, 32.0), (18.0, 22.0), (3, 5))
    assert case.replace({"stress": None}).stress is None
    assert case.replace({"stress.exclude": 0}).stress.exclude == 0.0


def test_grid_points_are_in_one_body_or_none():
    case = case_of("grid = { r = [28, 32], z = [19, 21], n = [9, 5] }")
    found = grid_bodies(case)
    assert found.shape == (9, 5)
    assert (found[:, :2] == 0).all()
    # on the plane: lower beside the contact and in it, none on the edges at 28.5 and 31.5
    assert found[:, 2].tolist() == [0, -1, 0, 0, 0, 0, 0, -1, 0]
    assert found[:, 3:].T.tolist() == [[-1, *[1] * 7, -1]] * 2
    upper = grid_bodies(case.replace({"stress.grid.body": "upper"}))
    assert set(upper[:, :2].ravel()) == {-1}
    assert upper[2:7, 2].tolist() == [1] * 5


def test_points_of_faces_apart_need_no_side():
    crowned = ["upper.profile={crown=100}"]
    case = case_of("points = [[29.0, 20.0], [29.0, 20.02]]", crowned)
    assert point_bodies(case) == [0, 1]
    assert case.gap_at(np.array([29.0])) == pytest.approx(0.005, rel=1e-2)


@pytest.mark.parametrize(
    ("stress", "said"),
    [
        ("points = [[30, 20]]", ["stress.points[0] = [30.0, 20.0]", '"below"', '"above"']),
        ("points = [[30, 19], [50, 10]]", ["stress.points[1] = [50.0, 10.0]", "outside both"]),
        ("points = [[28.5, 20]]", ["lies on an edge"]),
        ('points = [[25, 20, "above"]]', ["lies on a face with no body above it; must be without"]),
        ('points = [[30, 20, "left"]]', ["stress.points", '"above" or "below"']),
        ("points = [30, 20]", ["stress.points = [30, 20]", "a list of points [r, z]"]),
        ('points = [["30 N", 19]]', ["N is no unit of mm"]),
        (
            "grid = { r = [28, 32], z = [18, 20] }",
            ["stress.grid.n is missing: must be two whole numbers from 2 to 10000"],
        ),
        (
            "grid = { r = [32, 28], z = [18, 20], n = [2, 2] }",
            ["stress.grid.r = [32, 28]: must be two increasing numbers >= 0 (mm)"],
        ),
        ("grid = {}", ["[stress.grid]: is empty; must have one of its keys"]),
        ("grid = { r = [28, 32], z = [18, 20], n = [2, 2], m = 3 }", ["stress.grid.m: unknown"]),
        ("grid = { r = [28, 32], z = [18, 20], n = [2, 1] }", ["stress.grid.n = [2, 1]"]),
        (
            'grid = { body = "x", r = [28, 32], z = [18, 20], n = [2, 2] }',
            ['stress.grid.body = "x": must be "lower" or "upper" or "both"'],
        ),
        ("grid = { r = [1, 2], z = [18, 20], n = [2, 2] }", ["lie outside both bodies"]),
        (
            'grid = { body = "upper", r = [28, 32], z = [18, 19], n = [2, 2] }',
            ["lie outside upper"],
        ),
        ("grid = 3", ["stress.grid = 3: must be a table, [stress.grid]"]),
        (
            "points = [[30, 19], [30, 19]]",
            ["points[1] = [30.0, 19.0]: is stress.points[0] as well"],
        ),
        ("exclude = 20", ["stress.exclude = 20: leaves nothing of ", "must be less than 20 (mm)"]),
        ('times = "first"', ["stress.times", '"last", "all"']),
        ("times = [300]", ["stress.times: 300 is after the end", "<= 200 (s)"]),
        ("point = [[30, 19]]", ["stress.point", "stress.points"]),
        ("colour = 1", ["stress.colour: unknown key; must be points, times, exclude, grid"]),
        ("", ["[stress]: is empty"]),
    ],
)
def test_faults(stress, said):
    (fault,) = faults(stress)
    assert fault.startswith("case.toml: ")
    for part in said:
        assert part in fault


def test_points_between_layers_need_a_side():
    coated = ["lower.layers=[{thickness=0.3, young=1e5, poisson=0.3}]"]
    (fault,) = faults("points = [[30, 19.7]]", coated)
    assert "stress.points[0] = [30.0, 19.7]: lies between two layers" in fault
    case = case_of('points = [[30, 19.7, "above"], [30, 19.7, "below"], [30, 19.9]]', coated)
    assert point_bodies(case) == [0, 0, 0]
    (fault,) = faults('points = [[20, 19.7, "below"]]', coated)  # where the interface ends
    assert "lies on an edge" in fault


def test_a_side_inside_a_body_is_needless():
    """As in a sweep over a thickness, where the point lies on an interface in some cases only."""
    points = [
        (30.0, 19.7, "above"), (30.0, 19.7, "below"), (30.0, 25.0, "below"), (20.0, 10.0, "above"),
        (30.0, 0.0, "above"), (30.0, 40.0, "below"), (25.0, 20.0, "below"),
    ]  # fmt: skip
    told = f"points = {[list(point) for point in points]}"
    for layers in ([], ["lower.layers=[{thickness=0.3, young=1e5, poisson=0.3}]"]):
        case = case_of(told, layers)
        assert case.stress.points == tuple(points)
        assert point_bodies(case) == [0, 0, 1, 0, 0, 1, 0]
