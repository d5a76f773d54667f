"""Sweeps whose results are given, not computed."""

import warnings

import numpy as np
from mpi4py import MPI
from scipy.stats import qmc
from stored_cases import StoredCase, block_of

from ringwear_par.cases.schema import unit_of
from ringwear_par.results.variables import HISTORIES
from ringwear_par.studies.definition.variations import Column
from ringwear_par.studies.storage.case_index import CaseIndex
from ringwear_par.studies.ensemble import read_ensemble
from ringwear_par.studies.storage.results_writer import CaseList, write_results
from ringwear_par.studies.storage.shards import Shard, read_shard


def write(
    folder, names, rows, penetration, method="grid", lower=None, upper=None, steps=None,
    step=None, status=None, in_study=None,
):  # fmt: skip
    """Write a sweep whose penetrations grow linearly to given final values (mm)."""
    count = len(rows)
    lower = np.zeros(count) if lower is None else lower
    upper = np.zeros(count) if upper is None else upper
    steps = [10] * count if steps is None else steps
    step = [2.0] * count if step is None else step
    status = ["done"] * count if status is None else status
    in_study = [True] * count if in_study is None else in_study
    folder.mkdir(exist_ok=True)

    stored = [n for n in range(count) if status[n] != "incomplete"]

    def case(n):
        share = np.arange(steps[n] + 1) / steps[n]
        arrays = {name: np.zeros(steps[n] + 1) for name in HISTORIES}
        arrays["time"] = step[n] * np.arange(steps[n] + 1.0)
        arrays["penetration"] = penetration[n] * share
        arrays["worn_volume_lower"] = lower[n] * share
        arrays["worn_volume_upper"] = upper[n] * share
        arrays.update(r=np.ones(4), width=np.ones(4))
        return StoredCase(f"{n:016x}", status=status[n], columns=arrays)

    with Shard(folder / "all_0000.blocks") as shard:
        shard.add(block_of([case(n) for n in stored]))
    index = CaseIndex.of(read_shard(shard.path).blocks)
    columns = tuple(map(Column.of, map(list, zip(*rows, strict=True))))
    ids, entry = np.array([f"{n:016x}".encode() for n in range(count)]), np.full(count, -1)
    entry[stored] = np.arange(len(stored))
    cases = CaseList(
        dict(zip(names, columns, strict=True)),
        ids,
        np.array(in_study),
        index,
        entry,
        lambda missing: [""] * len(missing),
        {name: unit_of(name) for name in names},
    )
    attributes = {"method": method, "study": "", "status": "complete", "ranks": 1}
    write_results(folder, cases, attributes, MPI.COMM_SELF)
    shard.path.unlink()
    return read_ensemble(folder)


def sample(keys, count, seed=3):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a Sobol sample of another number than a power of 2
        return qmc.Sobol(len(keys), seed=seed).random(count)
