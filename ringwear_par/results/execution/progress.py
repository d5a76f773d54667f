"""How far a run, a sweep or a fit is: a bar on a terminal, else a line now and then."""

import logging
import math
import sys
import time
from collections.abc import Callable
from typing import Any

from tqdm import tqdm

from ringwear_par.history.snapshots import Snapshot

log = logging.getLogger(__name__)

#: wall seconds between lines where there is no terminal
PROGRESS_SECONDS = 10.0
_BAR_SECONDS = 0.2


class Progress:
    """Observer that tells of the time simulated.

    Parameters
    ----------
    start : s, time simulated before.
    end : s.
    """

    def __init__(self, start: float, end: float) -> None:
        self._end, self._last_line = end, time.perf_counter()
        self._bar: Any = tqdm(
            total=end, initial=start, unit="s", leave=False, disable=not sys.stderr.isatty(),
            bar_format="{l_bar}{bar}| {n:.4g}/{total:.4g} s simulated [{elapsed}<{remaining}]",
        )  # fmt: skip

    def __call__(self, snapshot: Snapshot) -> bool:
        """Tell of a state. Not collective."""
        state, time_reached = snapshot.state, float(snapshot.state.time[0])
        if not self._bar.disable:
            self._bar.update(time_reached - self._bar.n)
            return False
        now = time.perf_counter()
        if now - self._last_line > PROGRESS_SECONDS:
            self._last_line = now
            log.info(
                "step %d, time %.6g of %.6g s, approach %.6f mm",
                snapshot.progress.steps[0], time_reached, self._end, state.contact.approach[0],
            )  # fmt: skip
        return False

    def close(self) -> None:
        """Remove the bar."""
        self._bar.close()


class SweepProgress:
    """Observer that tells of cases done and failed, rate and time left.

    Parameters
    ----------
    done, failed : cases that had ended before.
    total : all cases.
    ended : returns how many are done and have failed since.
    """

    def __init__(
        self, done: int, failed: int, total: int, ended: Callable[[], tuple[int, int]]
    ) -> None:
        self._before, self._total, self._ended = (done, failed), total, ended
        self._begun = self._last_line = time.perf_counter()
        self._bar: Any = tqdm(
            total=total, initial=done + failed, unit="case", leave=False, smoothing=0.0,
            disable=not sys.stderr.isatty(),
        )  # fmt: skip
        self._pause = PROGRESS_SECONDS if self._bar.disable else _BAR_SECONDS

    def __call__(self, snapshot: Snapshot | None = None) -> bool:
        """Tell, if it is time."""
        now = time.perf_counter()
        if now - self._last_line < self._pause:
            return False
        self._last_line = now
        done, failed = self._ended()
        ended = done + failed + sum(self._before)
        rate = (done + failed) / (now - self._begun)
        failures = failed + self._before[1]
        if not self._bar.disable:
            self._bar.set_postfix_str(f"{failures} failed", refresh=False)
            self._bar.update(ended - self._bar.n)
            return False
        left = (self._total - ended) / rate if rate else math.inf
        log.info(
            "%d of %d cases ended, %d failed, %.3g a second, %s left",
            ended, self._total, failures, rate, duration(left),
        )  # fmt: skip
        return False

    def close(self) -> None:
        """Remove the bar."""
        self._bar.close()


class FitProgress:
    """Tells how many histories a fit has had computed, and what it is at."""

    def __init__(self) -> None:
        self._last_line = time.perf_counter()
        self._bar: Any = tqdm(
            unit=" histories", leave=False, smoothing=0.0, disable=not sys.stderr.isatty(),
            bar_format="{desc}{n_fmt}{unit} [{elapsed}, {rate_noinv_fmt}]",
        )  # fmt: skip

    def __call__(self, histories: int) -> None:
        """Tell how many there are by now; on a terminal only."""
        if not self._bar.disable:
            self._bar.update(histories - self._bar.n)

    def tell(self, state: str) -> None:
        """Print the state of the fit; without a terminal now and then."""
        if not self._bar.disable:
            self._bar.set_description(state)
        elif time.perf_counter() - self._last_line > PROGRESS_SECONDS:
            self._last_line = time.perf_counter()
            log.info("%s", state)

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
