"""``rw.plot`` and ``ringwear plot``: the figure of some results, or of a sweep."""

import logging
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.reading import read_case
from ringwear_par.errors import InputError
from ringwear_par.files.folders import refuse_drawn
from ringwear_par.pictures import figures, style
from ringwear_par.pictures import matplotlib as drawing
from ringwear_par.pictures.rig import draw_rig
from ringwear_par.results.result import Result
from ringwear_par.studies.ensemble import Ensemble, read_ensemble
from ringwear_par.studies.pictures import choose, effects, histories, index_panels

log = logging.getLogger(__name__)

#: most panels in a row, and inches of a panel and of a line of a legend
_COLUMNS, _PANEL, _LINE = 4, (2.3, 2.1), 0.18
#: letters of a line in a title, of a legend for each inch, and of a label along a panel
_TITLE_LETTERS, _LEGEND_LETTERS, _LABEL_LETTERS = 100, 14, 26


def plot(
    results: Case | figures.Source | Sequence[figures.Source],
    panels: str | Sequence[str] | None = None,
    steps: str = "",
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
        return style.of_width(draw_rig(results), width)
    several = [results] if isinstance(results, Result | str | Path) else results
    sources = several if isinstance(several, Sequence) else ()
    for path in (Path(source) for source in sources if isinstance(source, str | Path)):
        if not path.is_dir() and path.suffix != ".toml":
            continue
        refuse_drawn(path)
        if len(sources) > 1 or panels is not None or steps or times:
            raise InputError(
                f"{path}: a folder or a case must be drawn alone, without other options"
            )
        if path.is_dir():
            return style.of_width(draw_sweep(read_ensemble(path)), width)
        return style.of_width(draw_rig(read_case(path)), width)
    return figures.plot(several, panels or figures.DEFAULT, steps, times, width)


def plot_stored(
    results: Sequence[Path], output: Path, dpi: float | None = None, **choices: Any
) -> None:
    """Write the picture of runs, of a sweep or of the rig of a case; see ``plot``. On one rank.

    The ending of the output chooses the format; dpi are the points of an inch, where it has such.
    """
    style.check_format(output)
    figure = plot(results, **{name: choice for name, choice in choices.items() if choice})
    style.save_figure(figure, output, dpi)


# -- of a sweep ------------------------------------------------------------------------------------


def draw_sweep(ensemble: Ensemble) -> Figure:
    """Return the figure of a sweep's results. Not collective."""
    choice = choose(ensemble)
    if choice.absence:
        log.info("no surrogate: %s", choice.absence)
    panels, bars = effects(ensemble, choice), [*index_panels(choice).values()]
    keys = [key.name for key in choice.keys]
    rows = [[histories(ensemble, choice)]]
    rows += [bars[i : i + 3] for i in range(0, len(bars), 3)]
    rows += [
        [panels[output, key] for key in keys[i : i + _COLUMNS]]
        for i in range(0, len(keys), _COLUMNS)
        for output in choice.outputs
    ]
    width = _PANEL[0] * max(3, *map(len, rows))
    shapes = [
        [drawing.legend_shape(p, int(_LEGEND_LETTERS * width / len(row))) for p in row]
        for row in rows
    ]
    heights = [_PANEL[1] + 0.4 + _LINE * max(lines for _, lines in shape) for shape in shapes]
    with matplotlib.rc_context(style.STYLE):
        figure = style.NotebookFigure(figsize=(width, sum(heights) + 0.5), layout="constrained")
        title = [choice.counts, *textwrap.wrap(choice.remark, _TITLE_LETTERS)]
        figure.suptitle("\n".join(map(style.plain, title)), fontsize=9.0)
        parts: Any = figure.subfigures(len(rows), 1, height_ratios=heights, squeeze=False)[:, 0]
        for part, row, shape in zip(parts, rows, shapes, strict=True):
            all_axes, entries = part.subplots(1, len(row), squeeze=False)[0], dict[str, Any]()
            for axes, panel, (columns, _) in zip(all_axes, row, shape, strict=True):
                drawing.draw(axes, panel, columns if panel.legend else 0)
                if not panel.legend:
                    entries |= drawing.legend_entries(axes)
                axes.set_xlabel(textwrap.fill(axes.get_xlabel(), _LABEL_LETTERS))
                axes.set_ylabel(textwrap.fill(axes.get_ylabel(), _LABEL_LETTERS))
                if not (panel.x.log or panel.x.categories):
                    axes.locator_params(axis="x", nbins=4 if len(row) > 1 else 8)
            drawing.add_shared_legend(part, entries)
        drawing.add_letters(figure)
    return figure
