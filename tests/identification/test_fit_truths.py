"""What fits print, against scipy's distributions and against truths that were planted."""

import numpy as np
import pytest
from laboratory import (
    TRUTH,
    fit_tables,
    history,
    penetration,
    profile,
    write_table,
    write_tests,
)
from mpi4py import MPI
from scipy.stats import kstest, norm

import ringwear_par as rw

PRESSURES, FITS = (40.0, 85.0), 12
#: mm, of penetrations and profiles: far more than what lies between steps and elements
SD = (1e-3, 4e-4)
#: um, um a test, um and um/mm, as the laboratory has them
NUISANCES = {"offset": 1.0, "drift": 0.3, "level": 0.2, "tilt": 0.05}


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    """Function that fits readings with the noise of a seed; returns the fit, and the readings."""
    folder = tmp_path_factory.mktemp("truths")
    experiments, true = write_tests(folder, PRESSURES), [history(p) for p in PRESSURES]

    def fitted(seed, **settings):
        rng, read = np.random.default_rng(seed), []
        for number, (result, test) in enumerate(zip(true, experiments, strict=True), start=1):
            names = (f"z{number}.csv", "t_s", "z_um"), (f"d{number}.csv", "r_mm", "d_um")
            clean = penetration(result), profile(result)
            for (x, y), sd, data, (file, *columns) in zip(
                clean, SD, test["data"], names, strict=True
            ):
                read.append((x, y + sd * rng.standard_normal(len(x))))
                write_table(folder / file, columns, x, 1e3 * read[-1][1])
                data["sd"] = 1e3 * sd
        return rw.fit(fit_tables(folder, experiments, **settings), MPI.COMM_SELF), read

    return fitted


@pytest.fixture(scope="module")
def fits(laboratory):
    """Fits of many seeds, and the readings of the last one."""
    every = [laboratory((2, seed)) for seed in range(FITS)]
    return [found for found, _ in every], every[-1][1]


def test_chi2_and_its_freedom(fits):
    """Of histories in other steps, nuisances at their best: a number less for each that is free."""
    found, read = fits[0][-1], fits[1]
    best, squares = found.problem.values(found.solution.best), 0.0
    for pressure, record, face in zip(PRESSURES, read[::2], read[1::2], strict=True):
        result = history(pressure, dict(zip(TRUTH, best, strict=True)))
        t, r = record[0] / record[0][-1], face[0] - 30.0
        for off, columns, sd, prior in (
            (record[1] - penetration(result, None, None, 0.0, 0.0)[1], [1 + 0 * t, t],
             SD[0], 5e-4),
            (face[1] - profile(result, None, 0.0, 0.0)[1], [1 + 0 * r, r], SD[1], np.inf),
        ):  # fmt: skip
            design = np.vstack([np.column_stack(columns) / sd, [0.0, 1.0 / prior]])
            data = np.append(off / sd, 0.0)
            squares += np.linalg.lstsq(design, data, rcond=None)[1][0]
    told, n = found.to_dict(), sum(len(x) for x, _ in read)
    assert told["chi2"] == pytest.approx(squares, abs=0.5)
    assert told["degrees_of_freedom"] == pytest.approx(n - 3 * len(PRESSURES) - 2, abs=0.5)


@pytest.mark.parametrize("level", [0.95, 0.8])
def test_intervals_are_as_wide_as_their_level_says(laboratory, fits, level):
    """Of keys that are known so well that their posterior is normal."""
    found = fits[0][0] if level == 0.95 else laboratory((2, 0), level=level)[0]
    for one in found.parameters.values():
        low, high = one["interval"]
        assert 0.0 < one["sd"] < 0.05 * one["estimate"]
        half = 0.5 * (high - low) / one["sd"]
        assert half == pytest.approx(norm.ppf(0.5 + 0.5 * level), rel=0.06)


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say(fits):
    """Ten numbers of each fit, which hardly depend on each other; chi2 is by chance."""
    errors, inside = [], []
    for found in fits[0]:
        for key, one in found.parameters.items():
            errors.append((one["estimate"] - TRUTH[key]) / one["sd"])
            inside.append(one["interval"][0] < TRUTH[key] < one["interval"][1])
        for of_test in found.to_dict()["nuisance"].values():
            for kind, one in (item for of in of_test.values() for item in of.items()):
                errors.append((one["estimate"] - NUISANCES[kind]) / one["sd"])
                inside.append(abs(errors[-1]) < norm.ppf(0.975))
    assert len(inside) == 10 * FITS
    assert 0.88 <= np.mean(inside) <= 0.99
    assert np.std(errors) == pytest.approx(1.0, abs=0.25)
    assert np.mean(errors) == pytest.approx(0.0, abs=0.35)
    assert kstest([found.content["p_value"] for found in fits[0]], "uniform").pvalue > 0.01
