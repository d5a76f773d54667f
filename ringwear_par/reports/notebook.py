"""How notebooks show outcomes and studies: a summary and the picture."""

import base64
from html import escape

from ringwear_par.cases.units import with_signs
from ringwear_par.cases.values import is_number
from ringwear_par.errors import RingwearError
from ringwear_par.pictures.rig import rig_html
from ringwear_par.results.result import Outcome
from ringwear_par.studies.study import Study

#: of texts, whose lines may be longer than a cell is wide
_PRE = '<pre style="white-space: pre-wrap">'
#: values of a varied key that are listed
_LISTED = 8


def outcome_html(outcome: Outcome) -> str:
    """Return the summary and the figure of an outcome. Not collective.

    Where it holds too little for one of them, it is left out.
    """
    try:
        text = outcome.summary()
    except RingwearError:
        text = repr(outcome)
    return f"<div>{_PRE}{escape(with_signs(text))}</pre>{_picture(outcome)}</div>"


def _picture(outcome: Outcome) -> str:
    """Return the figure of an outcome as an image, "" where there is nothing to be drawn."""
    try:
        picture, size = outcome.plot()._repr_png_()  # type: ignore[attr-defined]
    except RingwearError:
        return ""
    address = base64.b64encode(picture).decode()
    alt = f"figure of the {type(outcome).__name__} that is summarised above"
    return f'<img src="data:image/png;base64,{address}" width="{size["width"]}" alt="{alt}">'


def study_html(study: Study) -> str:
    """Return the varied keys of a study, and the rig of its first case. Not collective."""
    rows, units = [], study.units()
    for name, column in study.columns.items():
        values = [*{str(value): value for value in column.tolist()}.values()]
        words = ", ".join(f"{v:.4g}" if is_number(v) else str(v) for v in values)
        if len(values) > _LISTED and all(map(is_number, values)):
            words = f"{len(values)} from {min(values):.4g} to {max(values):.4g}"
        cells = (escape(name), escape(words), units[name])
        rows.append(f"<tr>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>")
    table = "<table><tr><th>key</th><th>values</th><th>unit</th></tr>" + "".join(rows) + "</table>"
    return f"<div>{_PRE}{escape(repr(study))}</pre>{table}{rig_html(study.case(0))}</div>"
