"""How far a run, a sweep or a fit is: a bar on a terminal, else a line now and then."""

import logging
import math
import sys
import time
from collections.abc import Callable
from typing import Any

from ringwear_par.history.snapshots import Snapshot

log = logging.getLogger(__name__)

#: wall seconds between lines where there is no terminal, and between looks of a bar of a sweep
PROGRESS_SECONDS = 10.0
_BAR_SECONDS = 0.2


class _Progress:
    """A bar of tqdm on a terminal, None elsewhere."""

    def __init__(self, **bar: Any) -> None:
        self._begun = self._last = time.perf_counter()
        self._bar: Any = None
        if sys.stderr.isatty():
            from tqdm import tqdm  # slow to import

            self._bar = tqdm(leave=False, **bar)

    def _is_due(self) -> bool:
        """Tell whether the last time that it was is long enough ago."""
        now = time.perf_counter()
        if now - self._last <= (PROGRESS_SECONDS if self._bar is None else _BAR_SECONDS):
            return False
        self._last = now
        return True

    def close(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.close()


class RunProgress(_Progress):
    """Observer that shows the time simulated.

    Parameters
    ----------
    start : s, time simulated before.
    end : s.
    """

    def __init__(self, start: float, end: float) -> None:
        form = "{l_bar}{bar}| {n:.4g}/{total:.4g} s simulated [{elapsed}<{remaining}]"
        super().__init__(total=end, initial=start, bar_format=form)
        self._end = end

    def __call__(self, snapshot: Snapshot) -> bool:
        """Show how far a state is. Not collective."""
        reached = float(snapshot.state.time[0])
        if self._bar is not None:
            self._bar.update(reached - self._bar.n)
        elif self._is_due():
            log.info(
                "step %d, time %.6g of %.6g s, approach %.6f mm",
                snapshot.progress.steps[0], reached, self._end,
                snapshot.state.contact.approach[0],
            )  # fmt: skip
        return False


class SweepProgress(_Progress):
    """Observer that shows cases done and failed, rate and time left.

    Parameters
    ----------
    done, failed : cases that had ended before.
    total : all cases.
    ended : returns how many are done and have failed since.
    """

    def __init__(
        self, done: int, failed: int, total: int, ended: Callable[[], tuple[int, int]]
    ) -> None:
        super().__init__(total=total, initial=done + failed, unit="case", smoothing=0.0)
        self._before, self._total, self._ended = (done, failed), total, ended

    def __call__(self, snapshot: Snapshot | None = None) -> bool:
        """Show how far the sweep is, if the last time is long enough ago."""
        if not self._is_due():
            return False
        done, failed = self._ended()
        ended, failures = done + failed + sum(self._before), failed + self._before[1]
        if self._bar is not None:
            self._bar.set_postfix_str(f"{failures} failed", refresh=False)
            self._bar.update(ended - self._bar.n)
            return False
        rate = (done + failed) / (self._last - self._begun)
        log.info(
            "%d of %d cases ended, %d failed, %.3g a second, %s left", ended, self._total,
            failures, rate, duration((self._total - ended) / rate if rate else math.inf),
        )  # fmt: skip
        return False


class FitProgress(_Progress):
    """Shows how many histories a fit has had computed, and what it does."""

    def __init__(self) -> None:
        bar = "{desc}{n_fmt} histories [{elapsed}, {rate_noinv_fmt}]"
        super().__init__(smoothing=0.0, bar_format=bar)

    def __call__(self, histories: int) -> None:
        """Show how many there are by now; on a terminal only."""
        if self._bar is not None:
            self._bar.update(histories - self._bar.n)

    def tell(self, state: str) -> None:
        """Print the state of the fit; without a terminal now and then."""
        if self._bar is not None:
            self._bar.set_description(state)
        elif self._is_due():
            log.info("%s", state)


def duration(seconds: float) -> str:
    """Return a time in words."""
    if not math.isfinite(seconds):
        return "unknown time"
    if seconds < 120.0:
        return f"{seconds:.3g} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 120 else f"{minutes / 60:.1f} h"
