"""The folder of a running test: the last answer, and its page, written anew as readings come."""

import logging
import time
from collections.abc import Callable
from pathlib import Path

from ringwear_par.errors import InputError
from ringwear_par.files.folders import FOLLOW, json_bytes, write_outcome
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.monitoring.answer import Answer
from ringwear_par.monitoring.running_state import RunningTestState
from ringwear_par.pictures.panel import Panel
from ringwear_par.reports.report import check_page, write_page
from ringwear_par.version import versions

log = logging.getLogger(__name__)

#: their page
PAGE = "follow.html"
#: s between two pages, and between two lines
_PAUSE = 5.0


class AnswerFiles:
    """Writes answers. On one rank.

    Parameters
    ----------
    folder : of the files.
    command : that repeats them.
    """

    def __init__(self, folder: Path, command: str) -> None:
        self._folder, self._command = folder, command
        self.answer: Answer | None = None
        #: makes the chart of the readings that the answer is of
        self._record: Callable[[], Panel | None] = lambda: None
        self._paged, self._printed, self._alarmed = -_PAUSE, -_PAUSE, False
        self._has_page = True

    def write(
        self, answer: Answer, state: RunningTestState, problem: Problem, *, last: bool
    ) -> None:
        """Write an answer, its page now and then and at last, and say it.

        Raises
        ------
        ComputationError : the disk.
        """
        self.answer = answer
        content = {**answer.to_dict(), "versions": versions()}
        write_outcome(self._folder, "follow", {FOLLOW: lambda: json_bytes(content)})
        now = time.monotonic()
        self._record = lambda: state.record(problem)
        if last or now - self._paged > _PAUSE:
            self.write_page()
        alarm = answer.alarm is not None and not self._alarmed
        if not last and (alarm or now - self._printed > _PAUSE):
            lines = answer.lines()
            print(
                "\n".join(lines if alarm else lines[:-1] if answer.warnings else lines), flush=True
            )
            self._printed, self._alarmed = now, self._alarmed or alarm

    def write_page(self) -> None:
        """Write the page of the last answer; without bokeh there is none."""
        if self.answer is None or not self._has_page:
            return
        self._paged = time.monotonic()
        path = self._folder / PAGE
        try:
            check_page(path)
        except InputError as error:
            self._has_page = False
            log.warning("%s", error)
            return
        write_page(self.answer.page(self._record(), self._command, versions()), path)

    def closing_words(self) -> str:
        """Return the last answer in words, and the names of its files."""
        assert self.answer is not None
        names = [self._folder / name for name in (FOLLOW, PAGE)[: 1 + self._has_page]]
        return "\n".join([*self.answer.lines(), f"written: {', '.join(map(str, names))}"])
