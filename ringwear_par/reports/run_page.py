"""The page of a run."""

import io
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ringwear_par.cases.units import in_signs, with_signs
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import warning_lines
from ringwear_par.pictures import run_panels
from ringwear_par.pictures.figures import plot
from ringwear_par.pictures.stresses import along_height, along_interfaces, largest
from ringwear_par.reports import blocks as page
from ringwear_par.reports.case_words import case_words
from ringwear_par.results.key_numbers import (
    KeyNumber,
    check_numbers,
    checks,
    early_end,
    key_numbers,
    time_words,
    warnings_of,
)
from ringwear_par.results.result import Result

#: most times on a slider
_SLIDER = 120
#: most rows of a table that is not folded
_SHORT = 21


def run_page(result: Result) -> page.Page:
    """Return the page of a run. Not collective."""
    numbers, (rig, case) = key_numbers(result), case_words(result)
    doubts = warning_lines(map(with_signs, warnings_of(result)))
    wrong, errors = checks(result)
    passed = page.checks_tile(len(doubts), with_signs("; ".join([*wrong, errors])), len(wrong))
    blocks: list[page.Block] = [page.Tiles([*answers(numbers), passed]), *rig]
    if early := early_end(result):
        blocks.append(page.Lines([f"Ended {early}."]))
    if doubts:
        blocks.append(page.Lines(doubts, warning=True))
    header = ("quantity", "value", "unit")
    blocks.append(page.Table("Key numbers, at the end", header, key_rows(numbers)))
    sections = [page.Section("Summary", blocks)]
    drawn = profiles(result)
    absence = "No profiles are stored at several times (output.fields, output.profiles)."
    sections.append(
        page.Section(
            "Worn profiles and pressure", [page.Lines([absence]) if drawn is None else drawn]
        )
    )
    sections.append(page.Section("Histories", [histories(result)]))
    sections += _stresses(result)
    sections.append(page.Section("The case", case))
    sections.append(page.Section("Balances", [_errors(result)]))
    sections.append(_reproduced(result))
    return page.Page(
        "Wear history of a test",
        str(result.attributes.get("title") or "Run without a title"),
        sections,
    )


def answers(numbers: Iterable[KeyNumber]) -> list[page.Tile]:
    """Return the key numbers that a page of a run begins with."""
    known, tiles = {number.name: number for number in numbers}, []
    bodies = [body for body in BODIES if f"{body}_worn_volume" in known]
    labels = [("penetration", "penetration")]
    for body in bodies:
        suffix = f" of {body}" if len(bodies) > 1 else ""
        labels += [(f"{body}_worn_volume", f"worn volume{suffix}"),
                  (f"{body}_mass", f"mass lost{suffix}"),
                  (f"{body}_last_rate", f"wear rate{suffix}, at the end"),
                  (f"{body}_specific_rate", f"specific wear rate{suffix}")]  # fmt: skip
    labels += [("mean_pressure", "mean pressure"), ("largest_pressure", "largest pressure"),
              ("torque", "torque")]  # fmt: skip
    for name, label in labels:
        number = known.get(name)
        if number is not None and number.known:
            tiles.append(page.Tile(label, number.text, in_signs(number.unit)))
    return tiles


def histories(result: Result) -> page.Charts:
    """Return the charts of the quantities over time that the result holds."""
    return page.Charts([
        page.Chart(name, panel, f"Line chart: {panel.title} over {panel.x.label}")
        for name, panel in run_panels.histories(result).items()
    ])  # fmt: skip


def profiles(result: Result) -> page.Charts | None:
    """Return worn faces and pressure at five instants and at that of a slider; None: not stored."""
    panels = {
        f"wear-{body}": (run_panels.worn_faces(result, [body]), run_panels.worn_depth(result, body))
        for body in run_panels.worn_bodies(result)
    }
    if run_panels.at_all_states(result, "pressure"):
        panels["pressure"] = run_panels.pressure(result), result.profiles["pressure"]
    if not panels:
        return None
    time = result.histories["time"]
    rows = np.unique(np.linspace(0, len(time) - 1, _SLIDER).round().astype(int)).tolist()
    charts = []
    for name, (panel, values) in panels.items():
        times = ", ".join(curve.name for curve in panel.curves)
        label = f"Line chart: {panel.y.label} over the {run_panels.RADIUS} at {times}"
        frames = [values[row].tolist() for row in rows]
        chosen = run_panels.at_instant(result, values[rows[-1]])
        panel = replace(panel, curves=[*panel.curves, chosen])
        charts.append(page.Chart(name, panel, label, 400, frames))
    instants = [time_words(t, float(time[-1])) for t in time[rows].tolist()]
    return page.Charts(charts, instants, len(rows) - 1)


def key_rows(numbers: Iterable[KeyNumber]) -> list[tuple[str, str, str]]:
    """Return key numbers as rows of name, value and unit."""
    rows = []
    for number in numbers:
        name = f"{number.group}, {number.label}" + f" ({number.note})" * bool(number.note)
        rows.append((name, number.text, in_signs(number.unit)))
    return rows


def _errors(result: Result) -> page.Table:
    caption = "Errors, the worst of all steps"
    rows = key_rows(check_numbers(result))
    return page.Table(caption, ("check", "error", "unit"), rows, folded=True)


def _stresses(result: Result) -> list[page.Section]:
    """Return the pictures of the stored stresses and the largest of them, nothing without."""
    if not (stress := result.stress):
        return []
    times, last = stress["stress_time"].tolist(), [-1]
    label = "Line chart: von Mises stress"
    blocks: list[page.Block] = []
    charts = []
    if "stress_grid" in stress:
        content = io.BytesIO()
        plot(result, "stress").savefig(content, format="png", dpi=150)
        alt = "Map of von Mises stress in the section"
        blocks.append(page.Picture("Stress inside", content.getvalue(), "image/png", alt))
        along = along_height(result, "", last)
        charts.append(page.Chart("depth", along, f"{label} along the height at {along.legend}"))
    if any(f"interface_z_{body}" in stress for body in BODIES):
        blocks.append(
            page.Lines(["Beside von Mises stress: tractions along interfaces of layers."])
        )
        charts += [
            page.Chart(f"interface-{number}", panel, f"Line chart: {panel.y.label}, {panel.title}")
            for number, panel in enumerate(along_interfaces(result, "", last), start=1)
        ]
    if len(times) > 1:  # one is no history
        charts.append(
            page.Chart("mises", largest([result], [""]), f"{label}, the largest over time")
        )
    if charts:
        blocks.append(page.Charts(charts))
    rows = [
        (f"{time:.6g}", body, f"{top[t]:.5g}", f"{r[t]:.6g}", f"{z[t]:.6g}")
        for t, time in enumerate(times)
        for body in BODIES
        for top, r, z in [[stress[f"max_mises_{body}{end}"] for end in ("", "_r", "_z")]]
    ]
    header = ("time (s)", "ring", "von Mises (MPa)", "at r (mm)", "z (mm)")
    caption = f"Largest von Mises stress, {stress['stress_exclude']:g} mm and more from edges"
    blocks.append(page.Table(caption, header, rows, folded=len(rows) > _SHORT))
    return [page.Section("Stress inside", blocks)]


def _reproduced(result: Result) -> page.Section:
    about = result.attributes
    ranks = int(about.get("ranks", 1))
    launched = f"mpirun -n {ranks} " if ranks > 1 else ""
    commands = (
        f"{launched}ringwear run case.toml -o run.h5\nringwear report run.h5 -o report.html\n"
        "ringwear plot run.h5 -o run.png\n"
    )
    first = "Save the case file above as case.toml"
    if result.user_laws:
        first += ", and the laws under the names that it has for them"
    seconds = {
        name.removeprefix("seconds_"): f"{float(value):.3g}"
        for name, value in about.items()
        if name.startswith("seconds_")
    }
    rows = [("MPI ranks", str(ranks)), *((f"{k}, s", v) for k, v in seconds.items())]
    caption = "Ranks, and seconds that it took"
    table = page.Table(caption, ("what", "value"), rows, folded=True)
    return page.reproduced(
        f"{first}, then type:", commands, [], page.stored_versions(about), [table]
    )
