"""[stress] in case files: points, grids, sides, units."""

from paths import PAPER

from ringwear_par.cases.case import Grid
from ringwear_par.cases.files.reading import parse_case
from ringwear_par.cases.stress_points import grid_bodies, point_bodies

TEXT = PAPER.read_text()


def case_of(stress, overrides=()):
    return parse_case(f"{TEXT}\n[stress]\n{stress}\n", "case.toml", overrides)


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


def test_grid_points_are_in_one_body_or_outside_both():
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
