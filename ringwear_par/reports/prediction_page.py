"""The page of a prediction, from what its folder holds."""

import shlex
from pathlib import Path

from ringwear_par.cases.units import in_signs, with_signs
from ringwear_par.errors import legible
from ringwear_par.files import folders
from ringwear_par.prediction.prediction import band_panel
from ringwear_par.reports import blocks as page
from ringwear_par.reports.fit_page import stored_outcome
from ringwear_par.results.variables import DISPLAY_UNITS

_WARNING = "warning: "


def prediction_page(folder: Path) -> page.Page:
    """Return the page of the folder of a prediction. Not collective.

    Raises
    ------
    InputError : it is damaged.
    """
    with stored_outcome(folder / folders.PREDICTION, "the outcome of ringwear predict") as outcome:
        lines = [with_signs(line) for line in outcome["summary"]]
        warnings = [line.removeprefix(_WARNING) for line in lines if line.startswith(_WARNING)]
        answer = [line for line in lines if not line.startswith(_WARNING)]
        label = "Penetration over time: median, and bands that hold 50 and 95 % of the draws"
        header = ("at the end", "unit", *(f"{100 * p:g} %" for p in outcome["probabilities"]))
        rows = []
        for name, entry in outcome["quantiles"].items():
            unit, scale = DISPLAY_UNITS.get(name, (entry["unit"], 1.0))
            values = (f"{scale * value:.4g}" for value in entry["values"][-1])
            rows.append([name.replace("_", " "), in_signs(unit), *values])
        command = (
            f"ringwear predict {shlex.quote(outcome['fit'])} case.toml -o DIR "
            f"--of {shlex.quote(outcome['of'])} --draws {outcome['draws'] + outcome['failed']} "
            f"--seed {outcome['seed']}"
        )
        if outcome.get("depth") is not None:
            command += f" --depth '{1e3 * outcome['depth']['depth']:g} um'"
        summary: list[page.Block] = [page.Lines(answer)]
        if warnings:
            summary.append(page.Lines(warnings, warning=True))
        summary.append(page.Table("Quantiles of the draws", header, rows))
        chart = page.chart(band_panel(outcome), label, 4.0, wide=True)
        sections = [
            page.Section("Summary", summary),
            page.Section("Penetration", [page.Pictures([chart])]),
            page.reproduced(
                "Save the case file as case.toml, then type:", f"{command}\n",
                [page.Source("Case file", outcome["case"])], outcome["versions"],
            ),
        ]  # fmt: skip
    return page.Page("Prediction", f"Predicted: {legible(folder.resolve().name)}", sections)
