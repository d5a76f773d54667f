"""The end of a sweep: results.h5 and cases.csv of all that is stored."""

import logging
import time
from contextlib import suppress

import numpy as np
from mpi4py import MPI

from ringwear_par.errors import InputError, RingwearError
from ringwear_par.results.hdf5 import UnreadableError
from ringwear_par.studies.execution.plan import Plan
from ringwear_par.studies.execution.summary import Summary
from ringwear_par.studies.storage.blocks import DamagedError
from ringwear_par.studies.storage.case_index import CaseIndex
from ringwear_par.studies.storage.ensemble import read_ensemble
from ringwear_par.studies.storage.folder import reporting_unreadable
from ringwear_par.studies.storage.results_file import RESULTS
from ringwear_par.studies.storage.results_writer import CaseList, write_results
from ringwear_par.version import versions

log = logging.getLogger(__name__)

#: s, how long cases that another machine has stored may stay unseen (NFS: a minute by default), and
#: between two looks for them
_PATIENCE_SECONDS, _NAP_SECONDS = 75.0, 0.2


@reporting_unreadable()
def merge_if_well(plan: Plan, summary: Summary, well: bool, comm: MPI.Comm) -> tuple[int, int]:
    """Merge if all is well and this is no slice; return how many cases are stored, done and failed.

    On rank 0 of comm, which the others help, see ``parallel.results_of_tasks``.
    """
    if not well:
        with suppress(RingwearError, OSError):  # there is trouble enough to tell
            return plan.count(plan.folder.scan(mend=False)[0])
        return summary.done, summary.failed
    awaited = summary.done + summary.failed
    while True:
        index = _scan(plan, awaited)
        try:
            if not plan.folder.part:
                _merge(plan, summary, index, comm)
        except DamagedError as error:
            log.warning("%s", plan.folder.mend(error.path))
            awaited = 0  # the cases in it will not come to light
            continue
        return plan.count(index)


def _scan(plan: Plan, awaited: int) -> CaseIndex:
    """Return the stored cases; if they are fewer than awaited, network disks may show them late."""
    limit = time.monotonic() + _PATIENCE_SECONDS
    while True:
        index, notes = plan.folder.scan(mend=True)
        for note in notes:
            log.warning("%s", note)
        if notes or sum(plan.count(index)) >= awaited or time.monotonic() > limit:
            return index
        time.sleep(_NAP_SECONDS)


def _merge(plan: Plan, summary: Summary, index: CaseIndex, comm: MPI.Comm) -> None:
    """Write results.h5 and cases.csv of all that is stored, then drop the shards. On rank 0."""
    study, folder, ranks = plan.study, plan.folder, len(summary.timings)
    if not summary.computed and (folder.path / RESULTS).exists():
        try:
            ranks = int(read_ensemble(folder.path).attributes["ranks"])
        except UnreadableError:
            raise
        except InputError as error:
            raise DamagedError(folder.path / RESULTS) from error
    entry = index.find(study.identities)
    gone = np.setdiff1d(np.arange(len(index)), entry)
    cases = CaseList(
        dict(zip(study.names, study.cases.columns, strict=True)),
        np.concatenate([study.identities, index["id"][gone]]),
        np.arange(len(entry) + len(gone)) < len(entry),
        index,
        np.concatenate([entry, gone]),
        study.texts,
        study.cases.units(),
    )
    ended = sum(plan.count(index))
    complete = ended == summary.total and summary.computed == plan.cases_left
    attributes = {
        "status": "complete" if complete else "incomplete",
        "study": study.text,
        "method": study.method,
        "ranks": ranks,
        **versions(),
    }
    write_results(folder.path, cases, attributes, comm)
    if ended >= summary.done + summary.failed:  # else they may yet come to light
        folder.forget_shards()
