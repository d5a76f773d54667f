"""Signals that ask to stop: at once while there is nothing to keep, later after a step."""

import atexit
import os
import signal
import sys
import time
from collections.abc import Callable
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGTERM, signal.SIGUSR1, signal.SIGINT, signal.SIGHUP)
#: after so long a signal is another wish, not the same one told twice
_AGAIN_SECONDS = 1.0
#: how long to wait until what cannot be stopped is over
_LATER_SECONDS = 0.05
#: after which rank 0 says why it ends, if it has not: mpirun kills a second after its signal
_WORD_SECONDS = 0.7
#: variables that launchers set: mpirun of Open MPI and MPICH, and srun
_LAUNCHED = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMI_RANK", "PMIX_RANK", "SLURM_PROCID")


def is_launched() -> bool:
    """Tell whether mpirun or srun has started this process."""
    return any(name in os.environ for name in _LAUNCHED)


def name_of(number: int) -> str:
    """Return the name of a signal."""
    return signal.Signals(number).name


def ignore_at_end() -> None:
    """Ignore them all once Python ends: what there was to stop is over, its status is known."""
    atexit.unregister(_ignore)
    atexit.register(_ignore)


def _ignore() -> None:
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def remark(number: int) -> str:
    """Return the end of a sentence on a signal that may not be the one that the user sent."""
    if number == signal.SIGTERM and "OMPI_COMM_WORLD_SIZE" in os.environ:
        return "; SIGTERM is mpirun's word for Ctrl-C and SIGHUP, too"
    return ""


class Stopped(BaseException):
    """A signal asks to stop, and there is nothing to bring to an end first.

    Parameters
    ----------
    number : of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(name_of(number))
        self.number = number


class StopSignals:
    """Notes signals that ask to stop, instead of dying of them; a context manager.

    An ignored SIGHUP stays so, as nohup wants it.
    """

    def __init__(self) -> None:
        #: the last signal received, or 0
        self.received = 0
        self._old: dict[int, Any] = {}

    @property
    def noted(self) -> bool:
        """Whether signals are taken over."""
        return bool(self._old)

    def __enter__(self) -> Any:
        for number in SIGNALS:
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
                self._old[number] = signal.signal(number, self._receive)
        return self

    def __exit__(self, *_: object) -> None:
        if signal.SIGALRM in self._old:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in self._old.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if remark(number) and not self.received and os.environ.get("OMPI_COMM_WORLD_RANK") == "0":
            self._call_later(self._say, _WORD_SECONDS)
        self.received = number

    def _call_later(self, handler: Callable[[int, FrameType | None], None], delay: float) -> None:
        """Call a handler by SIGALRM, unless all is over by then."""
        old = signal.signal(signal.SIGALRM, handler)
        self._old.setdefault(signal.SIGALRM, old)
        signal.setitimer(signal.ITIMER_REAL, delay)

    def _say(self, number: int, frame: FrameType | None) -> None:
        """Say it while there is time: what is under way does not end before mpirun kills."""
        name, end = name_of(self.received), remark(self.received)
        os.write(
            2, f"ringwear: stopped by {name} before a step under way has ended{end}\n".encode()
        )


class StopAtOnce(StopSignals):
    """Turns signals that ask to stop into ``Stopped``; a context manager."""

    def __init__(self) -> None:
        super().__init__()
        self._time = 0.0
        self._hook = sys.unraisablehook

    def __enter__(self) -> Any:
        sys.unraisablehook = self._unraisable
        return super().__enter__()

    def __exit__(self, *_: object) -> None:
        super().__exit__()
        sys.unraisablehook = self._hook
        if self.received:  # the program ends: if it is told so again, with the same status
            signal.signal(self.received, signal.SIG_IGN)
            signal.signal(signal.SIGINT, signal.SIG_DFL)  # without a traceback

    def check(self) -> None:
        """Raise Stopped if a signal has come; what it ended may have raised something else."""
        if self.received:
            raise Stopped(self.received)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if not self.received or now - self._time > _AGAIN_SECONDS:
            self.received, self._time = number, now
            raise Stopped(number)

    def _receive_again(self, number: int, frame: FrameType | None) -> None:
        raise Stopped(self.received)

    def _unraisable(self, unraisable: "sys.UnraisableHookArgs") -> None:
        """Stop a little later where it came while an object was taken down, which ends nothing."""
        if isinstance(unraisable.exc_value, Stopped):
            self._call_later(self._receive_again, _LATER_SECONDS)
        else:
            self._hook(unraisable)
