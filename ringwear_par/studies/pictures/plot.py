"""``rw.plot`` and ``ringwear plot``: the figure of some results, or of a sweep."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.reading import read_case
from ringwear_par.errors import InputError
from ringwear_par.files.folders import refuse_drawn
from ringwear_par.pictures import figures
from ringwear_par.pictures.rig import draw_rig
from ringwear_par.pictures.style import check_format, of_width, save_figure
from ringwear_par.results.result import Result


def plot(
    results: Case | figures.Source | Sequence[figures.Source],
    panels: str | Sequence[str] | None = None,
    steps: str = "",
    profiles_of: Sequence[figures.Source] = (),
    times: str = "",
    width: float | None = None,
) -> Figure:
    """Return the panels of results side by side, the figure of a sweep, or the rig of a case.

    Not collective. Profiles (``wear``, ``pressure``) and deformed sections (``section``, the last
    one stored) are drawn of every result, one panel each; the histories of all of them share a
    panel (``penetration``, ``approach``, ``force``, ``torque``, ``energy``, ``volume``, ``rate``,
    ``pv``).

    Parameters
    ----------
    results : a result or a result file, or several; the folder of a sweep; or a case or its file,
        whose rig is drawn as a section through the axis.
    panels : names, in a list or separated by commas; None for wear and penetration.
    steps : comma-separated step numbers of the profiles.
    profiles_of : those of the results whose profiles and sections are drawn; () for all.
    times : comma-separated times of the profiles, s or with a unit ("1 h"), instead of steps; the
        stored states nearest to them are drawn. Without either: the first step and four quarters.

    width : mm, of the figure; None: what suits it.

    Returns
    -------
    matplotlib.figure.Figure : it belongs to no window; ``.savefig`` writes it.

    Raises
    ------
    InputError : something that is not a result, an unknown panel, a step not stored; more than its
        folder where a sweep is drawn; the folder of a fit or a design, which has its pictures.

    Examples
    --------
    >>> import ringwear_par as rw
    >>> result = rw.simulate(rw.read_case("scripts/cases/paper.toml"))
    >>> rw.plot(result, "wear,pressure", times="1 s, 200 s").savefig("run.png")
    """
    if isinstance(results, Case):
        return of_width(draw_rig(results), width)
    several = [results] if isinstance(results, Result | str | Path) else results
    sources = several if isinstance(several, Sequence) else ()
    for path in (Path(source) for source in sources if isinstance(source, str | Path)):
        if not path.is_dir() and path.suffix != ".toml":
            continue
        refuse_drawn(path)
        if len(sources) > 1 or panels is not None or steps or times or profiles_of:
            raise InputError(
                f"{path}: a folder or a case must be drawn alone, without other options"
            )
        if path.is_dir():
            from ringwear_par.studies.ensemble import read_ensemble
            from ringwear_par.studies.pictures.figures import draw_sweep

            return of_width(draw_sweep(read_ensemble(path)), width)
        return of_width(draw_rig(read_case(path)), width)
    return figures.plot(several, panels or figures.DEFAULT, steps, profiles_of, times, width)


def plot_stored(
    results: Sequence[Path], output: Path, dpi: float | None = None, **choices: Any
) -> None:
    """Write the picture of runs, of a sweep or of the rig of a case; see ``plot``. On one rank.

    The ending of the output chooses the format; dpi are the points of an inch, where it has such.
    """
    check_format(output)
    figure = plot(results, **{name: choice for name, choice in choices.items() if choice})
    save_figure(figure, output, dpi)
