"""What a long command says and hears on its way: how far it is, and signals that ask to stop."""

import logging
import math
import os
import signal
import sys
import threading
import time
from types import FrameType
from typing import Any

log = logging.getLogger(__name__)

#: wall seconds between lines where there is no terminal, and between updates of a bar on one
PROGRESS_SECONDS, BAR_SECONDS = 10.0, 0.2
SIGNALS = (signal.SIGTERM, signal.SIGUSR1, signal.SIGINT, signal.SIGHUP)
#: seconds within which a signal is the same request: ``timeout`` sends it twice
_SAME_SECONDS = 1.0


class Progress:
    """Shows how much is done, where the last time is long enough ago: a bar on a terminal.

    Parameters
    ----------
    total, start : of a bar, and done before; None: no bar, only a text.
    silent : whether to show nothing, as on other ranks than the first.
    """

    def __init__(
        self, total: float | None = None, start: float = 0.0, *, silent: bool = False
    ) -> None:
        self._last = time.perf_counter()
        self._bar: Any = None
        self._pause = math.inf if silent else PROGRESS_SECONDS
        if sys.stderr.isatty() and not silent:
            from tqdm import tqdm  # slow to import

            form = "{desc} [{elapsed}]" if total is None else "{desc} {bar} [{elapsed}<{remaining}]"
            bar = tqdm(total=total, initial=start, leave=False, smoothing=0.0, bar_format=form)
            self._bar, self._pause = bar, BAR_SECONDS

    def is_due(self) -> bool:
        """Tell whether to show something by now."""
        return time.perf_counter() - self._last > self._pause

    def show(self, reached: float, text: str, *numbers: Any) -> None:
        """Show a text, formatted with numbers, and how much is done, if it is due."""
        if not self.is_due():
            return
        self._last = time.perf_counter()
        if self._bar is None:
            log.info(text, *numbers)
        else:
            self._bar.set_description_str(text % numbers, refresh=False)
            self._bar.n = reached
            self._bar.refresh()

    def close(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.close()


def duration(seconds: float) -> str:
    """Return a time in words."""
    if seconds < 120.0:
        return f"{seconds:.3g} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 120 else f"{minutes / 60:.1f} h"


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
        self._unheard: Any = None

    def __enter__(self) -> Any:
        if threading.current_thread() is threading.main_thread():
            for number in SIGNALS:
                if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
                    self._old[number] = signal.signal(number, self._receive)
            if self._at_once:
                self._unheard, sys.unraisablehook = sys.unraisablehook, self._raise_again
        return self

    def __exit__(self, *_: object) -> None:
        sys.unraisablehook = self._unheard or sys.unraisablehook
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

    def _raise_again(self, lost: Any) -> None:
        """Send a signal again whose KeyboardInterrupt was lost, as in a destructor."""
        if self.received and issubclass(lost.exc_type, KeyboardInterrupt):
            number, self.received = self.received, 0
            threading.Timer(0.01, os.kill, (os.getpid(), number)).start()
        else:
            self._unheard(lost)
