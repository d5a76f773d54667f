"""How far a run, a sweep or a fit is: a bar on a terminal, else a line now and then."""

import logging
import math
import os
import re
import shlex
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ringwear_par.history.snapshots import Snapshot
from ringwear_par.results.execution.stop_signals import is_launched
from ringwear_par.results.result import Result
from ringwear_par.results.summary import labelled

log = logging.getLogger(__name__)

#: wall seconds between lines where there is no terminal
PROGRESS_SECONDS = 10.0
_BAR_SECONDS = 0.2


class _Progress:
    """A bar on a terminal, which looks as tqdm has it, else lines."""

    def __init__(self, **bar: Any) -> None:
        self._begun = self._last = time.perf_counter()
        self._bar: Any = None
        if sys.stderr.isatty():
            from tqdm import tqdm  # slow to import

            self._bar = tqdm(leave=False, **bar)

    @property
    def _on_terminal(self) -> bool:
        return self._bar is not None

    def _is_due(self, pause: float = PROGRESS_SECONDS) -> bool:
        """Tell whether the last time that it was is so many wall seconds ago."""
        now = time.perf_counter()
        if now - self._last <= pause:
            return False
        self._last = now
        return True

    def _move_to(self, reached: float) -> None:
        self._bar.update(reached - self._bar.n)

    def close(self) -> None:
        """Remove the bar."""
        if self._on_terminal:
            self._bar.close()


class RunProgress(_Progress):
    """Observer that tells of the time simulated.

    Parameters
    ----------
    start : s, time simulated before.
    end : s.
    """

    def __init__(self, start: float, end: float) -> None:
        super().__init__(
            total=end, initial=start, unit="s",
            bar_format="{l_bar}{bar}| {n:.4g}/{total:.4g} s simulated [{elapsed}<{remaining}]",
        )  # fmt: skip
        self._end = end

    def __call__(self, snapshot: Snapshot) -> bool:
        """Tell of a state. Not collective."""
        state, time_reached = snapshot.state, float(snapshot.state.time[0])
        if self._on_terminal:
            self._move_to(time_reached)
        elif self._is_due():
            log.info(
                "step %d, time %.6g of %.6g s, approach %.6f mm",
                snapshot.progress.steps[0], time_reached, self._end, state.contact.approach[0],
            )  # fmt: skip
        return False


class SweepProgress(_Progress):
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
        super().__init__(total=total, initial=done + failed, unit="case", smoothing=0.0)
        self._before, self._total, self._ended = (done, failed), total, ended

    def __call__(self, snapshot: Snapshot | None = None) -> bool:
        """Show how far the sweep is, if the last time is long enough ago."""
        if not self._is_due(_BAR_SECONDS if self._on_terminal else PROGRESS_SECONDS):
            return False
        done, failed = self._ended()
        ended, failures = done + failed + sum(self._before), failed + self._before[1]
        rate = (done + failed) / (self._last - self._begun)
        if self._on_terminal:
            self._bar.set_postfix_str(f"{failures} failed", refresh=False)
            self._move_to(ended)
            return False
        left = (self._total - ended) / rate if rate else math.inf
        log.info(
            "%d of %d cases ended, %d failed, %.3g a second, %s left",
            ended, self._total, failures, rate, duration(left),
        )  # fmt: skip
        return False


class FitProgress(_Progress):
    """Tells how many histories a fit has had computed, and what it is at."""

    def __init__(self) -> None:
        bar = "{desc}{n_fmt}{unit} [{elapsed}, {rate_noinv_fmt}]"
        super().__init__(unit=" histories", smoothing=0.0, bar_format=bar)

    def __call__(self, histories: int) -> None:
        """Tell how many there are by now; on a terminal only."""
        if self._on_terminal:
            self._move_to(histories)

    def tell(self, state: str) -> None:
        """Print the state of the fit; without a terminal now and then."""
        if self._on_terminal:
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


#: of texts that are printed on a terminal: their first words, and what they say of checks
_COLOURS = (
    (re.compile(r"^warning(?=:)", re.MULTILINE), "1;33"),
    (re.compile(r"(?<=^checks       )ok", re.MULTILINE), "32"),
    (re.compile(r"^[a-z][a-z ]{0,11}(?=  )", re.MULTILINE), "1"),
)


def for_terminal(text: str) -> str:
    """Return a text with colours where standard output is a terminal that shows some.

    mpirun has one of its own for each rank, wherever it writes to.
    """
    plain = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    if plain or is_launched() or not sys.stdout.isatty():
        return text
    for words, colour in _COLOURS:
        text = words.sub(f"\x1b[{colour}m\\g<0>\x1b[0m", text)
    return text


def closing_lines(output: Path, result: Result, finished: bool) -> list[str]:
    """Return the lines about the file of a run, and about the command to type next."""
    file, page = (shlex.quote(str(path)) for path in (output, output.with_suffix(".html")))
    after = f"ringwear report {file} -o {page}" if finished else "the same command with --restart"
    states = len(result.step)
    return labelled(
        [("written", f"{output} ({states} state{'s' * (states > 1)})"), ("next", after)]
    )
