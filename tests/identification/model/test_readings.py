"""What instruments read of a history: between steps, along the radius, with noise in time."""

from dataclasses import replace

import numpy as np
import pytest
from laboratory import fit_tables, write_tests
from mpi4py import MPI

import ringwear_par as rw
from ringwear_par.files.text import parse_toml
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import Nuisance, Series
from ringwear_par.identification.model.histories import Histories, step_times
from ringwear_par.identification.model.noise import log_volume, whitened
from ringwear_par.identification.model.readings import (
    TimeInterpolation,
    nuisance_columns,
)

SERIES = Series("a", "penetration", np.arange(1.0, 6.0), np.zeros(5), np.ones(5), factor=1e-3)


def test_readings_between_steps_do_not_round_a_kink():
    breaks = (0.0, 40.0, 40.001, 100.0)
    early = np.geomspace(1e-2, 40.0, 40)
    late = 40.001 + np.geomspace(1e-2, 59.999, 40)
    time = np.concatenate([[0.0], early, [40.0005, 40.001], late])

    def exact(t):
        return np.where(t <= 40.0, 1 - np.exp(-t / 5), 3 - np.exp(-8.0) - np.exp(-(t - 40) / 5))

    at = np.setdiff1d(np.linspace(0.1, 100.0, 400), [40.0005])
    read = TimeInterpolation(time, at, breaks)(exact(time)[:, None])[:, 0]
    assert np.abs(read - exact(at)).max() < 1e-4


def test_noise_in_time_becomes_white():
    rng = np.random.default_rng(3)
    x = np.cumsum(rng.uniform(0.5, 2.0, 4000))
    series = replace(SERIES, x=x, correlation_time=3.0)
    noise = np.empty(len(x))
    noise[0] = rng.standard_normal()
    for i in range(1, len(x)):
        share = np.exp(-(x[i] - x[i - 1]) / 3.0)
        noise[i] = share * noise[i - 1] + np.sqrt(1 - share**2) * rng.standard_normal()
    white = whitened(series, noise)
    assert np.corrcoef(noise[1:], noise[:-1])[0, 1] > 0.5
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 4 / np.sqrt(len(x))
    assert np.std(white) == pytest.approx(1.0, abs=0.05)


def test_noise_that_hardly_changes_is_no_division_by_zero():
    series = replace(SERIES, correlation_time=1e17)
    with np.errstate(all="raise"):
        white = whitened(series, np.arange(5.0))
        volume = log_volume(series)
    step = np.sqrt(2e-17)
    assert white == pytest.approx([0.0, *[1.0 / step] * 4], rel=1e-12)
    assert volume == pytest.approx(4 * np.log(step), rel=1e-12)


def test_nuisances():
    load = [[0, 40], [2, 40], [4, 80]]
    case = rw.read_case("scripts/cases/paper.toml", {"load.force": load, "time.steps": 10})
    kinds = tuple(Nuisance(kind) for kind in ("offset", "drift", "compliance"))
    columns = nuisance_columns(replace(SERIES, nuisances=kinds), case)
    expected = [np.ones(5), SERIES.x / 10.0, 1e-3 * np.array([0, 0, 20, 40, 40])]
    assert pytest.approx(1e-3 * np.array(expected)) == columns.T
    tilted = replace(SERIES, quantity="profile.lower", nuisances=(Nuisance("tilt"),))
    assert nuisance_columns(tilted, case)[:, 0] == pytest.approx(1e-3 * (SERIES.x - 30.0))


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    folder = tmp_path_factory.mktemp("laboratory")
    experiments = write_tests(folder, (60.0,), seed=None)
    for data in experiments[0]["data"]:
        del data["nuisance"]
    experiments[0]["data"] += [
        {"quantity": "mass.lower", "value": 1.0, "unit": "mg", "density": 7.8e-3, "sd": 0.1},
        {"quantity": "volume.lower", "value": 1.0, "unit": "mm3", "at": 50.0, "sd": 0.1},
        {"quantity": "torque", "value": 1.0, "unit": "N m", "at": 50.0, "sd": 0.1},
        {"quantity": "approach", "value": 1.0, "unit": "um", "at": 50.0, "sd": 0.1},
    ]
    return read_fit(fit_tables(folder, experiments))


def test_readings_are_those_of_the_history(problem, comm):
    """Against a history with its own small steps, in units of what instruments resolve."""
    experiment = problem.experiments[0]
    (found,) = Histories(problem, comm).responses(np.array([[1.3e-7, 25.0]]))
    fine = {"time.tolerance": 1e-7, "output.fields": ["wear_lower"], "output.times": [50.0]}
    truth = {"wear.lower.k": 1.3e-7, "wear.lower.p0": 25.0}
    result = rw.simulate(experiment.case.replace({**truth, **fine}))
    middle, last = 1, 2
    pen, prof, mass, volume, torque, approach = np.split(
        found[:, 0], np.cumsum([s.n for s in experiment.series])[:-1]
    )
    assert result.histories["time"][middle] == 50.0
    assert pen[-1] == pytest.approx(result.histories["penetration"][last], abs=2e-5)
    flank = (experiment.series[1].x < 28.5) | (experiment.series[1].x > 31.5)
    assert (prof[flank] == 0).all()
    assert (prof[~flank] > 1e-3).all()
    at_mid_points = np.interp(result.line.r, experiment.series[1].x, prof)[3:-3]
    assert at_mid_points == pytest.approx(result.profiles["wear_lower"][last][3:-3], rel=0.02)
    assert mass[0] == pytest.approx(7.8e-3 * result.histories["worn_volume_lower"][last], rel=2e-3)
    assert volume[0] == pytest.approx(result.histories["worn_volume_lower"][middle], rel=4e-3)
    assert torque[0] == pytest.approx(result.histories["torque"][middle], rel=1e-4)
    assert approach[0] == pytest.approx(result.histories["approach"][middle], abs=2e-5)


def derivatives_defect(histories, point):
    """Return how far derivatives are from central differences, over the largest; the worst."""
    (found,) = histories.responses(point[None])
    worst = 0.0
    for j, step in enumerate(np.diag(1e-4 * point)):
        up, down = histories.responses(np.array([point + step, point - step]))
        slope = (up[:, 0] - down[:, 0]) / (2 * step[j])
        worst = max(worst, np.abs(slope - found[:, 1 + j]).max() / np.abs(slope).max())
    return worst


def test_readings_have_their_derivatives(problem, comm):
    """Central differences over the same steps."""
    assert derivatives_defect(Histories(problem, comm), np.array([1.3e-7, 25.0])) < 1e-5


def coated(folder, bounds):
    """Return a fit file of the thickness and modulus of a coating that wears through, as a dict."""
    experiments = write_tests(folder, (60.0,), seed=None)
    tables = fit_tables(folder, experiments)
    layer = {"thickness": 2e-3, "young": 1e5, "poisson": 0.3, "wear": {"law": "archard", "k": 3e-9}}
    base = parse_toml((folder / "case.toml").read_text(), "case")
    base["lower"]["layers"] = [layer]
    base["mesh"] = {"contact_elements": 16}
    tables["case"] = base
    tables["fit"]["parameters"] = {
        "lower.layers[0].thickness": {"start": 2e-3, "bounds": bounds},
        "lower.layers[0].young": {"start": 1e5, "bounds": [1e4, 4e5], "scale": "log"},
    }
    return tables


def test_readings_have_derivatives_where_each_point_has_its_operator(tmp_path, comm):
    problem = read_fit(coated(tmp_path, [1e-3, 5e-3]))
    assert derivatives_defect(Histories(problem, comm), np.array([2.1e-3, 1.2e5])) < 1e-3


def test_a_mass_is_that_of_each_layer(tmp_path, comm):
    """As what is lost of each layer says, with derivatives, of the thickness too."""
    tables = coated(tmp_path, [1e-3, 5e-3])
    weighing = {"quantity": "mass.lower", "unit": "mg", "sd": 0.1}
    times = (20.0, 36.0, 100.0)
    tables["experiment"][0]["data"] = [{**weighing, "value": 1.0, "at": at} for at in times]
    tables["case"]["lower"]["density"] = 7.8e-3
    tables["case"]["lower"]["layers"][0]["density"] = 1.2e-3
    tables["fit"]["parameters"] = {
        "lower.layers[0].thickness": {"start": 2e-3, "bounds": [1e-3, 5e-3]},
        "lower.layers[0].wear.k": {"start": 3e-9, "bounds": [1e-10, 1e-7], "scale": "log"},
        "wear.lower.k": {"start": 1e-7, "bounds": [1e-9, 1e-5], "scale": "log"},
    }
    problem = read_fit(tables)
    histories, point = Histories(problem, comm), np.array([2.1e-3, 1e-8, 1.2e-7])
    (found,) = histories.responses(point[None])
    case = problem.experiments[0].case.replace(
        {
            **dict(zip(problem.keys, point.tolist(), strict=True)),
            "time.scheme": "adaptive", "time.tolerance": 1e-7, "output.times": list(times[:-1]),
        }
    )  # fmt: skip
    volumes = rw.simulate(case, MPI.COMM_SELF).layers["worn_volume_lower_layers"][1:]
    assert (volumes[1] < volumes[2]).all()  # here and there through it
    assert volumes[1, 1] > 0.0
    assert found[:, 0] == pytest.approx(volumes @ [1.2e-3, 7.8e-3], rel=4e-3)
    assert derivatives_defect(histories, point) < 1e-4


def test_a_layer_cannot_be_thicker_than_its_body(tmp_path):
    with pytest.raises(rw.InputError, match=r"thickness: no case at its bound 30: .*together"):
        read_fit(coated(tmp_path, [1e-3, 30.0]))


def test_steps_end_where_schedules_bend_and_profiles_are_read(problem):
    experiment = problem.experiments[0]
    load = {"load.pressure": [[0, 40], [30, 40], [30.1, 80], [100, 80]]}
    series = (replace(experiment.series[1], at=70.0),)
    bent = replace(experiment, case=experiment.case.replace(load), series=series)
    times = step_times(bent)
    assert {30.0, 30.1, 70.0, 100.0} <= set(times.tolist())
    assert (np.diff(times) > 0).all()
    assert 30 < len(times) < 80
