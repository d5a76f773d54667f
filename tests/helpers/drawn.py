"""Draws as a fit of one law's keys has them, made up for tests; and the folder of such a fit."""

from types import SimpleNamespace

import numpy as np
from parts import (
    Draws,
    FittedParameter,
    atomic_hdf5,
    conditions_of,
    law_names,
    write_draws,
)
from scipy.stats import norm

K, P0 = "wear.lower.k", "wear.lower.p0"
#: standard deviation of log k of the material, and between specimens
SD, TAU = 0.1, 0.3
BOUNDS = {K: (1e-9, 1e-5), P0: (0.0, 200.0)}


def draws_of(case, count=200, k=1e-7, p0=None, tau=0.0, size=0.0):
    """Return draws after tests of a case: log k, at quantiles of a normal, and p0 (draws,).

    Specimen "S2" has 1.5 k, exactly; ``size`` is that of the random wear of lower.
    """
    keys = (K,) if p0 is None else (K, P0)
    material = k * np.exp(SD * norm.ppf((np.arange(count) + 0.5) / count)[:, None])
    tests = np.column_stack([material, np.full(count, 1.5 * k)])
    material = material if p0 is None else np.column_stack([material, p0])
    parameters = [FittedParameter(key, 1.0, BOUNDS[key], log=key == K) for key in keys]
    return Draws(
        parameters, ["1/MPa", "MPa"][: len(keys)], ["S1", "S2"], ["S1", "S2"], law_names(case),
        [conditions_of(case, keys)] * 2, material, {K: tests},
        {(K, "specimen"): np.full(count, tau)} if tau else {},
        {"wear.lower": np.full(count, size)} if size else {},
    )  # fmt: skip


def fit_of(draws):
    """Return what rooms read of a fit with these draws."""
    return SimpleNamespace(draws=draws)


def save_fit(folder, fit):
    """Write what rooms read of the folder of a fit."""
    folder.mkdir()
    (folder / "fit.json").write_text("{}")
    with atomic_hdf5(folder / "draws.nc") as file:
        file.attrs["software"] = "ringwear-par"
        write_draws(file.create_group("posterior"), fit.draws)
    return folder
