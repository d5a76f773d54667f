"""What happens between the steps of a run: storing, progress, checkpoints, stopping on a signal."""

import logging
import signal
import sys
import time
from collections.abc import Callable
from types import FrameType
from typing import Any

import numpy as np
from mpi4py import MPI
from tqdm import tqdm

from ringwear_par.errors import ComputationError
from ringwear_par.history import State
from ringwear_par.results import Recorder

log = logging.getLogger(__name__)

#: wall seconds between checkpoints, and between lines of progress where there is no terminal
CHECKPOINT_SECONDS = 30.0
PROGRESS_SECONDS = 10.0
_SIGNALS = (signal.SIGTERM, signal.SIGUSR1, signal.SIGINT)


class Monitor:
    """Called with every new state; a context manager, for its signal handlers and progress bar.

    Parameters
    ----------
    steps : number of steps of the run.
    recorder : takes every state; None on ranks that store nothing.
    save : writes a checkpoint; collective.
    comm : communicator; calls are collective, and answered alike on all ranks.
    """

    def __init__(
        self, steps: int, recorder: Recorder | None, save: Callable[[State], None], comm: MPI.Comm
    ) -> None:
        self._steps, self._recorder, self._save, self._comm = steps, recorder, save, comm
        self._saved = self._told = time.perf_counter()
        self._received = 0  # here; only what the ranks agree on is acted upon
        self._agreed = 0
        self._old: dict[int, Any] = {}
        self._bar: Any = None

    @property
    def signal_name(self) -> str:
        """Name of the signal that stopped the run."""
        return signal.Signals(self._agreed).name

    def __enter__(self) -> "Monitor":
        for number in _SIGNALS:
            self._old[number] = signal.signal(number, self._receive)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._old.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        if self._bar is not None:
            self._bar.close()

    def _receive(self, number: int, frame: FrameType | None) -> None:
        self._received = number

    def __call__(self, state: State) -> bool:
        """Return whether to stop after this state. Collective."""
        now = time.perf_counter()
        if self._recorder is not None:
            self._recorder.add(state)
            self._tell(state, now)
        due = self._comm.rank == 0 and now - self._saved > CHECKPOINT_SECONDS
        request = np.array([self._received, due], dtype=np.int64)
        if self._comm.size > 1:
            self._comm.Allreduce(MPI.IN_PLACE, request, MPI.MAX)
        self._agreed = int(request[0])
        if request[1] and not self._agreed and state.step < self._steps:
            try:
                self._save(state)
            except ComputationError as error:
                if self._comm.rank == 0:
                    log.warning("checkpoint not written, going on: %s", error)
            self._saved = time.perf_counter()
        return self._agreed != 0

    def _tell(self, state: State, now: float) -> None:
        if self._bar is None:
            self._bar = tqdm(
                total=self._steps, initial=state.step - 1, unit="step", leave=False,
                disable=not sys.stderr.isatty(),
            )  # fmt: skip
        self._bar.update()
        if self._bar.disable and now - self._told > PROGRESS_SECONDS:
            self._told = now
            log.info(
                "step %d of %d, approach %.6f mm", state.step, self._steps, state.contact.approach
            )
