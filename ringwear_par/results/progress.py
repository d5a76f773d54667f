"""How far a run, a sweep or a fit is: a bar on a terminal, else a line now and then."""

import logging
import math
import sys
import time
from typing import Any

log = logging.getLogger(__name__)

#: wall seconds between lines where there is no terminal
PROGRESS_SECONDS = 10.0


class Progress:
    """Shows how much is done, where the last time is long enough ago.

    Parameters
    ----------
    total : of a bar; None: no bar, only a text.
    start : done before.
    pause : s, between updates of a bar.
    """

    def __init__(self, total: float | None = None, start: float = 0.0, pause: float = 0.2) -> None:
        self._last = time.perf_counter()
        self._bar: Any = None
        terminal = sys.stderr.isatty()
        self._pause = pause if terminal else PROGRESS_SECONDS
        if terminal:
            from tqdm import tqdm  # slow to import

            form = "{desc} [{elapsed}]" if total is None else "{desc} {bar} [{elapsed}<{remaining}]"
            self._bar = tqdm(
                total=total, initial=start, leave=False, smoothing=0.0, bar_format=form
            )

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
    if not math.isfinite(seconds):
        return "unknown time"
    if seconds < 120.0:
        return f"{seconds:.3g} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 120 else f"{minutes / 60:.1f} h"
