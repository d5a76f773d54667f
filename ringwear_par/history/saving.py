"""What of a history is saved: which steps and times, and which of them are asked for."""

from bisect import bisect_left, bisect_right

from ringwear_par.cases.case import SAME_TIME, Case


def _same(time: float, *others: float) -> bool:
    """Tell whether a time is one of others but for round-off."""
    return any(abs(time - other) <= SAME_TIME * time for other in others)


def stores(case: Case, step: int, time: float) -> bool:
    """Tell whether a case stores its state after so many steps, at a time (s)."""
    output = case.output
    if step == 0 or case.time.finished(step, time):
        return True
    if output.times:
        i = bisect_left(output.times, time)
        return any(_same(t, time) for t in output.times[max(i - 1, 0) : i + 1])
    return step % output.every == 0


def times_within(case: Case, start: float, end: float) -> list[float]:
    """Return the times of output strictly between two times, s."""
    times = case.output.times
    between = times[bisect_right(times, start) : bisect_left(times, end)]
    return [t for t in between if not _same(t, start, end)]


def wants(asked: str | tuple[float, ...], time: float, finished: bool, before: float) -> bool:
    """Tell whether a stored state is asked for.

    Parameters
    ----------
    asked : "none", "last", "all", or times (s) from each of which on the first stored state is.
    time : s, of the state.
    finished : whether it is the last.
    before : s, time of the stored state before it; negative: there is none.
    """
    if isinstance(asked, str):
        return asked == "all" or (asked == "last" and finished)
    near = SAME_TIME * time
    return any(before + near < t <= time + near for t in asked)
