"""Outcomes of runs, fits, designs of tests and measurements: data, with doors to what shows it."""

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Outcome:
    """Data whose looks and files are the matter of functions of its room.

    A class names the modules of these functions, which are loaded when a function is first used:
    no outcome knows any of them.
    """

    #: modules of functions of the outcome, by the functions' names
    functions: ClassVar[Mapping[str, str]]

    def apply(self, name: str, *arguments: Any) -> Any:
        """Return the value of a function of the outcome.

        Raises
        ------
        TypeError : there is no such function of it.
        """
        if name not in self.functions:
            raise TypeError(f"{type(self).__name__}: has no {name}")
        return getattr(import_module(self.functions[name]), name)(self, *arguments)

    def summary(self) -> str:
        """Return it in a few lines, as the command prints it. Not collective.

        Raises
        ------
        InputError : a result that was stored without its last state.
        """
        return str(self.apply("summary"))

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON can hold it, for a page or a script. Not collective.

        Raises
        ------
        InputError : a result that was stored without its last state.
        """
        return dict(self.apply("to_dict"))

    def plot(self) -> "Figure":
        """Return its figure."""
        figure: Figure = self.apply("plot")
        return figure

    def report(self, path: str | Path) -> str:
        """Write its page, one HTML file; return what was written, see ``rw.report``."""
        # pages stand on outcomes, which know nothing else of them
        return str(import_module("ringwear_par.reports.report").report(self, path))

    def _repr_html_(self) -> str:
        """Return its summary and figure, for notebooks."""
        return str(import_module("ringwear_par.reports.notebook").outcome_html(self))

    def save(self, path: str | Path) -> None:
        """Write its file, or the files of its folder, which is made.

        Not collective: the process that calls this writes, each file whole.

        Raises
        ------
        InputError : what cannot be written.
        ComputationError : the disk.
        """
        self.apply("save", Path(path))


def summary(outcome: Outcome) -> str:
    """Return an outcome in a few lines, see ``Outcome.summary``."""
    return _checked(outcome, "summary").summary()


def to_dict(outcome: Outcome) -> dict[str, Any]:
    """Return an outcome as JSON can hold it, see ``Outcome.to_dict``."""
    return _checked(outcome, "to_dict").to_dict()


def save(outcome: Outcome, path: str | Path) -> None:
    """Write an outcome to its file or folder, see ``Outcome.save``."""
    _checked(outcome, "save").save(path)


def _checked(outcome: Outcome, verb: str) -> Outcome:
    if not isinstance(outcome, Outcome):
        raise TypeError(f"{verb}: {type(outcome).__name__}: must be an outcome")
    return outcome
