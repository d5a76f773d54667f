"""Signals that ask to stop: after a step where there is something to keep, else at once."""

import os
import signal
import threading
import time
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGTERM, signal.SIGUSR1, signal.SIGINT, signal.SIGHUP)
#: seconds within which a signal is the same request: ``timeout`` sends it twice
_SAME_SECONDS = 1.0


def name_of(number: int) -> str:
    """Return the name of a signal."""
    return signal.Signals(number).name


class StopSignals:
    """Notes signals that ask to stop, instead of dying of them; a context manager.

    A second signal kills. An ignored SIGHUP stays so, as nohup wants it. Only the main thread may
    take signals over: in others nothing is noted.

    Parameters
    ----------
    at_once : raise KeyboardInterrupt with the name of the signal, too.
    """

    def __init__(self, at_once: bool = False) -> None:
        #: the first signal received, or 0
        self.received = 0
        self._at_once, self._time = at_once, 0.0
        self._old: dict[int, Any] = {}

    def __enter__(self) -> Any:
        if threading.current_thread() is threading.main_thread():
            for number in SIGNALS:
                if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
                    self._old[number] = signal.signal(number, self._receive)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._old.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if not self.received:
            self.received, self._time = number, time.monotonic()
            if self._at_once:
                raise KeyboardInterrupt(name_of(number))
        elif time.monotonic() - self._time > _SAME_SECONDS:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
