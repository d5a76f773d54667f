"""Two tests of the laboratory, with noise: what many tests of fits begin with."""

import copy

import numpy as np
import pytest
from laboratory import (
    CASE,
    END,
    FACTORS,
    FITTED,
    SD_PENETRATION,
    SHARE,
    TRUTH,
    fit_tables,
    history,
    one_test,
    penetration,
    record,
    write_tests,
)
from mpi4py import MPI

import ringwear_par as rw

K = "wear.lower.k"


@pytest.fixture(scope="session")
def laboratory(tmp_path_factory):
    """Their folder, and their experiments as dicts."""
    folder = tmp_path_factory.mktemp("laboratory")
    return folder, write_tests(folder)


@pytest.fixture(scope="session")
def tables(laboratory):
    """Function that makes a fit file of them as a dict, of which nothing is shared."""
    folder, written = laboratory
    return lambda **settings: fit_tables(folder, copy.deepcopy(written), **settings)


@pytest.fixture(scope="session")
def found(tables):
    """Their fit, of another law too; the noise of one profile is fitted."""
    tables = tables()
    tables["experiment"][1]["data"][1]["sd"] = "fit"
    law = {"wear.lower.law": "archard"}
    parameters = {"wear.lower.k": tables["fit"]["parameters"]["wear.lower.k"]}
    tables["compare"] = {"archard": {"set": law, "parameters": parameters}}
    return rw.fit(tables, MPI.COMM_SELF, compare=True)


@pytest.fixture(scope="session")
def specimens(tmp_path_factory):
    """The fit of three specimens that differ, whose wear is random, with noise that remembers."""
    folder, rng, experiments = tmp_path_factory.mktemp("specimens"), np.random.default_rng(5), []
    (folder / "case.toml").write_text(CASE)
    for number, factor in enumerate(FACTORS, start=1):
        pressure = (45.0, 80.0)[number % 2]
        result = history(pressure, {**TRUTH, K: TRUTH[K] * factor}, 1.5 * END)
        there, worn = (result.histories[name] for name in ("time", "worn_volume_lower"))
        times, full = np.linspace(2.0, END, 50), np.interp(END, there, worn)
        # steps of worn volume that are gamma distributed, of the mean that the law says
        steps = np.diff(np.interp(times, there, worn), prepend=0.0) / full
        ran = np.interp(full * SHARE**2 * np.cumsum(rng.gamma(steps / SHARE**2)), worn, there)
        t, z = penetration(result, None, ran)
        decay = np.exp(-np.abs(np.subtract.outer(times, times)) / 3.0)
        z += SD_PENETRATION * np.linalg.cholesky(decay) @ rng.standard_normal(len(t))
        nuisance = {"offset": {}, "drift": {"prior": {"normal": [0.1, 0.5]}}}
        data = record(folder / f"z{number}.csv", times, z, correlation_time=3.0, nuisance=nuisance)
        weighing = {"quantity": "mass.lower", "unit": "mg", "density": 7.8e-3, "sd": 0.3,
                    "value": 7.8 * np.interp(ran[-1], there, worn)}  # fmt: skip
        known = {"wear.lower.p0": TRUTH["wear.lower.p0"]}
        experiments.append(one_test(f"test {number}", pressure, data, weighing, **known))
    scattering = {**FITTED[K], "scatter": "fit"}
    process = {"wear.lower": {"share": SHARE}}
    tables = fit_tables(folder, experiments, process=process, parameters={K: scattering})
    return rw.fit(tables, MPI.COMM_SELF)
