"""What happens between the steps of a run: storing, progress, checkpoints, stopping on a signal."""

import logging
import math
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
from ringwear_par.history.model import State
from ringwear_par.parallel import PeerError
from ringwear_par.results.files import Recorder

log = logging.getLogger(__name__)

#: wall seconds between checkpoints, and between lines of progress where there is no terminal
CHECKPOINT_SECONDS = 30.0
PROGRESS_SECONDS = 10.0
_BAR_SECONDS = 0.2
_SIGNALS = (signal.SIGTERM, signal.SIGUSR1, signal.SIGINT)


class StopSignals:
    """Notes signals that ask to stop, instead of dying of them; a context manager."""

    def __init__(self) -> None:
        self.received = 0
        self._old: dict[int, Any] = {}

    def __enter__(self) -> "StopSignals":
        for number in _SIGNALS:
            self._old[number] = signal.signal(number, self._receive)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._old.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        self.received = number


class Monitor:
    """Called with every new state: stores it, writes checkpoints, stops on a signal.

    Parameters
    ----------
    finished : tells whether a state is the last.
    recorder : takes every state; None on ranks that store nothing.
    save : writes a checkpoint; collective.
    signals : noted here, acted upon when one of the ranks has received one.
    comm : communicator; calls are collective, and answered alike on all ranks.
    tell : called with every state on this rank only, for progress.
    """

    def __init__(
        self,
        finished: Callable[[State], bool],
        recorder: Recorder | None,
        save: Callable[[State], None],
        signals: StopSignals,
        comm: MPI.Comm,
        tell: Callable[[State], None] | None = None,
    ) -> None:
        self._finished, self._recorder, self._save, self._comm = finished, recorder, save, comm
        self._signals, self._tell = signals, tell
        self._saved = time.perf_counter()
        #: the signal that the ranks agreed to stop for, or 0
        self.agreed = 0
        #: the last state seen, None before the first
        self.last: State | None = None

    @property
    def signal_name(self) -> str:
        """Name of the signal that stopped the run."""
        return signal.Signals(self.agreed).name

    def show(self, state: State) -> None:
        """Take a state within a step, at a time of output. Not collective."""
        if self._recorder is not None:
            self._recorder.add(state)

    def fail(self) -> None:
        """Let the other ranks, which come to their meeting after this step, know of a failure.

        Collective: where one rank calls this, the others call the monitor, or this as well.
        """
        self._meet(0, False, failed=True)

    def _meet(self, received: int, due: bool, *, failed: bool) -> tuple[int, bool, bool]:
        """Return the worst of what the ranks say. Collective."""
        if self._comm.size == 1:
            return received, due, failed
        said = np.array([received, due, failed], dtype=np.int64)
        self._comm.Allreduce(MPI.IN_PLACE, said, MPI.MAX)
        return int(said[0]), bool(said[1]), bool(said[2])

    def __call__(self, state: State) -> bool:
        """Return whether to stop after this state. Collective.

        Raises
        ------
        PeerError : another rank has failed.
        """
        self.last = state
        if self._recorder is not None:
            self._recorder.add(state)
        if self._tell is not None:
            self._tell(state)
        late = self._comm.rank == 0 and time.perf_counter() - self._saved > CHECKPOINT_SECONDS
        received, due, failed = self._meet(self._signals.received, late, failed=False)
        if failed:
            raise PeerError("another rank has failed")
        self.agreed = received
        if due and not received and not self._finished(state):
            try:
                self._save(state)
            except ComputationError as error:
                if self._comm.rank == 0:
                    log.warning("checkpoint not written, going on: %s", error)
            self._saved = time.perf_counter()
        return received != 0


class Progress:
    """A bar of the time simulated on a terminal, else a line now and then.

    Parameters
    ----------
    start : s, time simulated before.
    end : s.
    """

    def __init__(self, start: float, end: float) -> None:
        self._end, self._told = end, time.perf_counter()
        self._bar: Any = tqdm(
            total=end, initial=start, unit="s", leave=False, disable=not sys.stderr.isatty(),
            bar_format="{l_bar}{bar}| {n:.4g}/{total:.4g} s simulated [{elapsed}<{remaining}]",
        )  # fmt: skip

    def __call__(self, state: State) -> None:
        """Tell of a state."""
        if not self._bar.disable:
            self._bar.update(state.time - self._bar.n)
            return
        now = time.perf_counter()
        if now - self._told > PROGRESS_SECONDS:
            self._told = now
            log.info(
                "step %d, time %.6g of %.6g s, approach %.6f mm",
                state.step, state.time, self._end, state.contact.approach,
            )  # fmt: skip

    def close(self) -> None:
        """Remove the bar."""
        self._bar.close()


class SweepProgress:
    """Cases done and failed, rate and time left: a bar on a terminal, else a line now and then.

    Parameters
    ----------
    done, failed : cases that had ended before.
    total : all cases.
    ended : returns how many are done and have failed since.
    comm : communicator of the sweep.
    """

    def __init__(
        self, done: int, failed: int, total: int, ended: Callable[[], tuple[int, int]],
        comm: MPI.Comm,
    ) -> None:  # fmt: skip
        self._before, self._total, self._ended, self._comm = (done, failed), total, ended, comm
        self._begun = self._told = time.perf_counter()
        self._bar: Any = tqdm(
            total=total, initial=done + failed, unit="case", leave=False, smoothing=0.0,
            disable=not sys.stderr.isatty(),
        )  # fmt: skip
        self._pause = PROGRESS_SECONDS if self._bar.disable else _BAR_SECONDS

    def __call__(self, state: State | None = None) -> None:
        """Tell, if it is time; and let MPI serve the other ranks, which some networks need."""
        if self._comm.size > 1:
            self._comm.Iprobe()
        now = time.perf_counter()
        if now - self._told < self._pause:
            return
        self._told = now
        done, failed = self._ended()
        ended = done + failed + sum(self._before)
        rate = (done + failed) / (now - self._begun)
        failures = failed + self._before[1]
        if not self._bar.disable:
            self._bar.set_postfix_str(f"{failures} failed", refresh=False)
            self._bar.update(ended - self._bar.n)
            return
        left = (self._total - ended) / rate if rate else math.inf
        log.info(
            "%d of %d cases ended, %d failed, %.3g a second, %s left",
            ended, self._total, failures, rate, duration(left),
        )  # fmt: skip

    def close(self) -> None:
        """Remove the bar."""
        self._bar.close()


def duration(seconds: float) -> str:
    """Return a time in words."""
    if not math.isfinite(seconds):
        return "unknown time"
    if seconds < 120.0:
        return f"{seconds:.3g} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 120 else f"{minutes / 60:.1f} h"
