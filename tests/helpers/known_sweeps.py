"""Sweeps whose results are given, not computed."""

import warnings

import numpy as np
from scipy.stats import qmc

from ringwear_par.results.variables import HISTORIES
from ringwear_par.studies.blocks import FOLDER, Block
from ringwear_par.studies.ensemble import read_ensemble
from ringwear_par.studies.results_file import derived, merge, write_block
from ringwear_par.studies.study import Study
from ringwear_par.studies.variations import column_of


def write(
    folder, names, rows, penetration, method="grid", lower=None, upper=None, steps=None,
    step=None, status=None,
):  # fmt: skip
    """Write a sweep whose penetrations grow linearly to given final values (mm)."""
    count = len(rows)
    steps = np.full(count, 10) if steps is None else np.array(steps)
    states = np.arange(steps.max() + 1.0)
    shares = np.where(states <= steps[:, None], states / steps[:, None], np.nan)
    ends = dict.fromkeys(HISTORIES, np.zeros(count))
    ends["time"] = steps * (np.full(count, 2.0) if step is None else np.array(step))
    ends["penetration"] = np.array(penetration, dtype=float)
    for body, volumes in (("lower", lower), ("upper", upper)):
        if volumes is not None:
            ends[f"worn_volume_{body}"] = np.array(volumes, dtype=float)
    ids = np.array([f"{n:016x}" for n in range(count)], "S")
    arrays = {name: values[:, None] * shares for name, values in ends.items()}
    arrays |= {"r": np.ones((count, 4)), "width": np.ones((count, 4))}
    arrays |= {"case": ids, "number": np.arange(count), "steps_stored": steps + 1}
    arrays |= {"elements": np.full(count, 4), "seconds": np.full(count, 0.1)}
    arrays |= {"imbalance": np.zeros(count), "error": np.zeros(count, "S1")}
    arrays |= {"flags": np.zeros(count, "S1"), "status": np.array(status or ["done"] * count, "S")}
    columns = map(column_of, map(list, zip(*rows, strict=True)))
    study = Study("study", "", method, {}, dict(zip(names, columns, strict=True)))
    (folder / FOLDER).mkdir(parents=True, exist_ok=True)
    block = Block(folder / FOLDER / "all.h5", np.arange(count))
    write_block(block, derived(arrays))
    merge(study, [block], folder, 1)
    return read_ensemble(folder)


def sample(keys, count, seed=3):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a Sobol sample of another number than a power of 2
        return qmc.Sobol(len(keys), seed=seed).random(count)
