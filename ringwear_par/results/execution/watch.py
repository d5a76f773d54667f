"""Observers that stop a history on a signal and write checkpoints on the way."""

import logging
import time
from collections.abc import Callable

import numpy as np
from mpi4py import MPI

from ringwear_par.errors import ComputationError
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.results.execution.stopping import StopSignals, name_of

log = logging.getLogger(__name__)

#: wall seconds between checkpoints
CHECKPOINT_SECONDS = 30.0


class Watch:
    """Observer in which ranks meet after every step, for a checkpoint or to stop.

    Parameters
    ----------
    signals : noted here, acted upon when one of the ranks has received one.
    save : writes a checkpoint of what there is; collective.
    comm : communicator; calls are collective, and answered alike on all ranks.
    """

    def __init__(self, signals: StopSignals, save: Callable[[], object], comm: MPI.Comm) -> None:
        self._signals, self._save, self._comm = signals, save, comm
        self._saved = time.perf_counter()
        #: why the last checkpoint was not written, "" if it was
        self._lacking = ""
        #: the signal that the ranks agreed to stop for, or 0
        self.agreed = 0

    @property
    def signal_name(self) -> str:
        """Name of the signal that stopped the history."""
        return name_of(self.agreed)

    def __call__(self, snapshot: Snapshot) -> bool:
        """Return whether to stop after this state. Collective."""
        if snapshot.passing or snapshot.step is None:
            return False
        received = self._signals.received
        due = self._comm.rank == 0 and time.perf_counter() - self._saved > CHECKPOINT_SECONDS
        if self._comm.size > 1:
            request = np.array([received, due], dtype=np.int64)
            self._comm.Allreduce(MPI.IN_PLACE, request, MPI.MAX)
            received, due = int(request[0]), bool(request[1])
        self.agreed = received
        if due and not received and not snapshot.finished.all():
            self._write_checkpoint()
        return received != 0

    def _write_checkpoint(self) -> None:
        """Write a checkpoint; tell once why it cannot be, and once that it can again."""
        lacking = ""
        try:
            self._save()
        except ComputationError as error:
            lacking = str(error)
        if lacking != self._lacking and self._comm.rank == 0:
            if lacking:
                log.warning("checkpoint not written, going on: %s", lacking)
            else:
                log.info("checkpoints are written again")
        self._lacking = lacking
        self._saved = time.perf_counter()
