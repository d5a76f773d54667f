"""What instruments read of histories: between steps, along the radius, with nuisances."""

from dataclasses import replace

import numpy as np
import pytest
from laboratory import fit_tables, write_tests
from linear_tests import series
from mpi4py import MPI
from parts import StopSignals, parse_toml

import ringwear_par as rw
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import Nuisance
from ringwear_par.identification.histories import Readings, step_times
from ringwear_par.identification.noise import coloured, log_volumes, whitened
from ringwear_par.identification.nuisances import column, growth
from ringwear_par.identification.readings import interpolation


def readings_of(problem, *values, **how):
    """Return the readings (P, n) of the first test at values of the keys."""
    points = np.array([problem.unknowns(one) for one in values])
    return Readings(problem, MPI.COMM_SELF, StopSignals())([(0, points)], **how)[0]


def test_readings_between_steps_do_not_round_a_kink():
    breaks = (0.0, 40.0, 40.001, 100.0)
    early, late = np.geomspace(1e-2, 40.0, 40), 40.001 + np.geomspace(1e-2, 59.999, 40)
    time = np.concatenate([[0.0], early, [40.0005, 40.001], late])

    def exact(t):
        return np.where(t <= 40.0, 1 - np.exp(-t / 5), 3 - np.exp(-8.0) - np.exp(-(t - 40) / 5))

    at = np.setdiff1d(np.linspace(0.1, 100.0, 400), [40.0005])
    read = interpolation(time, at, breaks) @ exact(time)
    assert np.abs(read - exact(at)).max() < 1e-4


def test_noise_in_time_becomes_white():
    record = replace(series(np.zeros(40)), correlation_time=6.0)
    root = coloured(record, np.eye(40))
    decay = np.exp(-np.abs(np.subtract.outer(record.x, record.x)) / 6.0)
    np.testing.assert_allclose(root @ root.T, decay, atol=1e-12)
    np.testing.assert_allclose(whitened(record, root), np.eye(40), atol=1e-12)
    assert log_volumes(record).sum() == pytest.approx(0.5 * np.linalg.slogdet(decay)[1])
    constant = replace(record, correlation_time=1e17)  # no division by zero
    with np.errstate(all="raise"):
        assert np.isfinite(whitened(constant, np.arange(40.0))).all()


def test_nuisances():
    load = [[0, 40], [2, 40], [4, 80]]
    case = rw.read_case("scripts/cases/paper.toml", {"load.force": load, "time.steps": 10})
    record = replace(series(np.zeros(5)), x=np.arange(1.0, 6.0), factor=1e-3)
    expected = {
        "offset": np.ones(5), "drift": record.x / 10.0, "tilt": record.x - 30.0,
        "compliance": 1e-3 * np.array([0, 0, 20, 40, 40]),
    }  # fmt: skip
    for kind, one in expected.items():
        added = column(Nuisance(kind), record, case, np.zeros(1))
        assert added == pytest.approx(1e-3 * one)


def test_growth_with_friction_power_is_a_sum_over_steps():
    """Steps of load and speed: 40, 80 and 20 of at most 80."""
    loads, speeds = [[3000.0, 40.0], [3000.001, 80.0]], [[5000.0, 1.0], [5000.001, 0.25]]
    case = rw.read_case("scripts/cases/paper.toml", {"load.pressure": loads, "load.omega": speeds})
    t = np.linspace(0.0, 7200.0, 97)
    expected = sum(
        share * -np.expm1(-np.maximum(t - start, 0.0) / 1500.0)
        for share, start in ((0.5, 0.0), (0.5, 3000.0), (-0.75, 5000.0))
    )
    (found,) = growth(Nuisance("thermal", power=True), case, t, np.array([1500.0]))
    assert found == pytest.approx(expected, abs=1e-6)


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


def test_readings_are_those_of_the_history(problem):
    """Against a history with its own small steps, in units of what instruments resolve."""
    experiment = problem.experiments[0]
    truth = {"wear.lower.k": 1.3e-7, "wear.lower.p0": 25.0}
    (found,) = readings_of(problem, [*truth.values()])
    fine = {"time.tolerance": 1e-7, "output.fields": ["wear_lower"], "output.times": [50.0]}
    result = rw.simulate(experiment.case.replace({**truth, **fine}), MPI.COMM_SELF)
    middle, last = 1, 2
    pen, prof, mass, volume, torque, approach = np.split(
        found, np.cumsum([s.n for s in experiment.series])[:-1]
    )
    assert pen[-1] == pytest.approx(result.histories["penetration"][last], abs=2e-5)
    flank = (experiment.series[1].x < 28.5) | (experiment.series[1].x > 31.5)
    assert (prof[flank] == 0).all()
    at_mid_points = np.interp(result.line.r, experiment.series[1].x, prof)[3:-3]
    assert at_mid_points == pytest.approx(result.profiles["wear_lower"][last][3:-3], rel=0.02)
    assert mass[0] == pytest.approx(7.8e-3 * result.histories["worn_volume_lower"][last], rel=2e-3)
    assert volume[0] == pytest.approx(result.histories["worn_volume_lower"][middle], rel=4e-3)
    assert torque[0] == pytest.approx(result.histories["torque"][middle], rel=1e-4)
    assert approach[0] == pytest.approx(result.histories["approach"][middle], abs=2e-5)


def test_factors_on_rates_and_tests_alike(problem):
    """Factors are those of k; tests that are alike share histories."""
    (good,) = readings_of(problem, [1.3e-7, 25.0])
    (faster,) = readings_of(problem, [1e-7, 25.0], factors=(1.3, 1.0))
    np.testing.assert_allclose(faster, good, rtol=1e-9)
    (test,) = problem.experiments
    other = replace(test, series=tuple(replace(s, value=s.value + 1.0) for s in test.series))
    shifted = replace(test, series=tuple(replace(s, x=0.5 * s.x) for s in test.series))
    three = replace(problem, experiments=(test, other, shifted))
    readings = Readings(three, MPI.COMM_SELF, StopSignals())
    assert readings.same_as == [0, 0, 2]
    both = readings([(1, np.array([[np.log(1.3e-7), 25.0]] * 2)), (0, np.zeros((0, 2)))])
    assert (readings.count, both[0].shape) == (1, (2, test.n))


def coated(folder):
    """Return a fit file of a test whose layer is worn through, weighed three times, as a dict."""
    tables = fit_tables(folder, write_tests(folder, (60.0,), seed=None))
    layer = {"thickness": 2e-3, "young": 1e5, "poisson": 0.3, "wear": {"law": "archard", "k": 3e-9}}
    base = tables["case"] = parse_toml((folder / "case.toml").read_text(), "case")
    base["lower"] |= {"layers": [{**layer, "density": 1.2e-3}], "density": 7.8e-3}
    weighing = {"quantity": "mass.lower", "unit": "mg", "sd": 0.1, "value": 1.0}
    tables["experiment"][0]["data"] = [{**weighing, "at": at} for at in (20.0, 36.0, 100.0)]
    tables["fit"]["parameters"] = {
        "lower.layers[0].thickness": {"start": 2e-3, "bounds": [1e-3, 5e-3]},
        "lower.layers[0].wear.k": {"start": 3e-9, "bounds": [1e-10, 1e-7], "scale": "log"},
        "wear.lower.k": {"start": 1e-7, "bounds": [1e-9, 1e-5], "scale": "log"},
    }
    return tables


def test_a_mass_is_that_of_each_layer(tmp_path):
    """As what is lost of each layer says, where thicknesses have operators of their own."""
    problem, values = read_fit(coated(tmp_path)), [2.1e-3, 1e-8, 1.2e-7]
    (found,) = readings_of(problem, values)
    time = {"time.scheme": "adaptive", "time.tolerance": 1e-7, "output.times": [20.0, 36.0]}
    case = problem.experiments[0].case.replace(
        {**dict(zip(problem.keys, values, strict=True)), **time}
    )
    volumes = rw.simulate(case, MPI.COMM_SELF).layers["worn_volume_lower_layers"][1:]
    assert (volumes[1] < volumes[2]).all()  # here and there through it
    assert volumes[1, 1] > 0.0
    assert found == pytest.approx(volumes @ [1.2e-3, 7.8e-3], rel=4e-3)
    tables = coated(tmp_path)
    tables["fit"]["parameters"]["lower.layers[0].thickness"]["bounds"][1] = 30.0
    with pytest.raises(rw.InputError, match=r"thickness: no case at its bound 30: .*together"):
        read_fit(tables)
    wide = replace(problem.parameters[0], bounds=(1e-3, 30.0))
    wider = replace(problem, parameters=(wide, *problem.parameters[1:]))
    assert np.isnan(readings_of(wider, [30.0, 1e-8, 1.2e-7])).all()


def test_steps_end_where_schedules_bend_and_profiles_are_read(problem):
    experiment = problem.experiments[0]
    load = {"load.pressure": [[0, 40], [30, 40], [30.1, 80], [100, 80]]}
    profile = (replace(experiment.series[1], at=70.0),)
    bent = replace(experiment, case=experiment.case.replace(load), series=profile)
    times = step_times(bent)
    assert {30.0, 30.1, 70.0, 100.0} <= set(times.tolist())
    assert (np.diff(times) > 0).all()
    assert 30 < len(times) < 80
