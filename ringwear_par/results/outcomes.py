"""Verbs that act on the outcomes of runs, fits and designs of tests.

An outcome is data: how it looks and where it is kept is the matter of functions of its room. Doors
to them stand here, and modules are loaded when a door is first used, so that no outcome knows any
of them.
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_FIT, _DESIGN = "ringwear_par.identification", "ringwear_par.identification.test_design"
_MEASURING, _PREDICTION = "ringwear_par.measuring", "ringwear_par.prediction"
#: modules of the functions, by the class of an outcome and the function's name
_MODULES = {
    ("Result", "summary"): "ringwear_par.results.summary",
    ("Result", "to_dict"): "ringwear_par.results.summary",
    ("Result", "save"): "ringwear_par.results.storage.result_files",
    ("FitResult", "summary"): f"{_FIT}.summary",
    ("FitResult", "warnings"): f"{_FIT}.summary",
    ("FitResult", "save"): f"{_FIT}.fit_folder",
    ("FitResult", "figure"): f"{_FIT}.figures",
    ("FitResult", "parameter_figure"): f"{_FIT}.figures",
    ("FitResult", "specimen_figure"): f"{_FIT}.figures",
    ("MeasureResult", "summary"): f"{_MEASURING}.summary",
    ("MeasureResult", "save"): f"{_MEASURING}.measure_folder",
    ("MeasureResult", "figure"): f"{_MEASURING}.figures",
    ("Prediction", "summary"): f"{_PREDICTION}.summary",
    ("Prediction", "to_dict"): f"{_PREDICTION}.summary",
    ("Prediction", "save"): f"{_PREDICTION}.folder",
    ("Prediction", "figure"): f"{_PREDICTION}.figure",
    ("DesignResult", "summary"): f"{_DESIGN}.design_numbers",
    ("DesignResult", "to_dict"): f"{_DESIGN}.design_numbers",
    ("DesignResult", "save"): f"{_DESIGN}.design_folder",
    ("DesignResult", "figure"): f"{_DESIGN}.design_figures",
}


def _apply(verb: str, outcome: Any, *arguments: Any) -> Any:
    module = _MODULES.get((type(outcome).__name__, verb))
    if module is None:
        raise TypeError(f"{verb}: {type(outcome).__name__}: must be the outcome of a run or a fit")
    return getattr(import_module(module), verb)(outcome, *arguments)


def summary(outcome: Any) -> str:
    """Return an outcome in a few lines, as the command prints it. Not collective.

    Raises
    ------
    InputError : a result that was stored without its last state.
    """
    return str(_apply("summary", outcome))


def to_dict(outcome: Any) -> dict[str, Any]:
    """Return an outcome for a page or a script, as JSON can hold it. Not collective.

    Raises
    ------
    InputError : a result that was stored without its last state.
    """
    if (type(outcome).__name__, "to_dict") in _MODULES:
        return dict(_apply("to_dict", outcome))
    return dict(outcome.to_dict())


def save(outcome: Any, path: str | Path) -> None:
    """Write an outcome to its file or folder. Not collective: the process that calls this writes.

    Raises
    ------
    InputError : what cannot be written.
    ComputationError : the disk.
    """
    _apply("save", outcome, Path(path))


def warnings(outcome: Any) -> tuple[str, ...]:
    """Return sentences against taking the numbers of a fit as they are."""
    return tuple(_apply("warnings", outcome))


def figure(outcome: Any) -> "Figure":
    """Return the figure of a fit, a design of tests, a measurement or a prediction."""
    drawn: Figure = _apply("figure", outcome)
    return drawn


def parameter_figure(outcome: Any) -> "Figure":
    """Return the figure of the fitted keys of a fit."""
    drawn: Figure = _apply("parameter_figure", outcome)
    return drawn


def specimen_figure(outcome: Any) -> "Figure":
    """Return the figure of the specimens of a fit with scatter.

    Raises
    ------
    InputError : a fit without scatter.
    """
    drawn: Figure = _apply("specimen_figure", outcome)
    return drawn
