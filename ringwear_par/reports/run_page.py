"""The page of a run."""

import io
from collections.abc import Iterable

import numpy as np

from ringwear_par.cases.case import CHANGED
from ringwear_par.cases.files.keys import read_keys
from ringwear_par.cases.files.reading import make_case
from ringwear_par.cases.units import in_signs, with_signs
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError, warning_lines
from ringwear_par.pictures import run_panels
from ringwear_par.pictures.figures import plot
from ringwear_par.pictures.panel import Panel
from ringwear_par.pictures.rig import rig_svg
from ringwear_par.pictures.stresses import along_height, along_interfaces, largest
from ringwear_par.reports import blocks as page
from ringwear_par.results.key_numbers import (
    KeyNumber,
    check_numbers,
    checks,
    early_end,
    key_numbers,
    warnings_of,
)
from ringwear_par.results.result import Result

#: most rows of a table that is not folded
_SHORT = 21
#: range of a history over its largest value below which a chart of it would be a level line
_LEVEL = 5e-3


def run_page(result: Result) -> page.Page:
    """Return the page of a run. Not collective."""
    numbers = key_numbers(result)
    doubts = warning_lines(map(with_signs, warnings_of(result)))
    wrong, errors = checks(result)
    passed = page.checks_tile(len(doubts), with_signs("; ".join([*wrong, errors])), len(wrong))
    blocks: list[page.Block] = [page.Tiles([*answers(numbers), passed]), *_rig(result)]
    if early := early_end(result):
        blocks.append(page.Lines([f"Ended {early}."]))
    if doubts:
        blocks.append(page.Lines(doubts, warning=True))
    header = ("quantity", "value", "unit")
    blocks.append(page.Table("Key numbers, at the end", header, key_rows(numbers)))
    case = [page.Source("Case file, as run", result.case)]
    case += [page.Source(f"Law of {body}, a file of the user's", source)
             for body, source in result.user_laws.items()]  # fmt: skip
    return page.Page(
        "Wear history of a test",
        str(result.attributes.get("title") or "Run without a title"),
        [
            page.Section("Summary", blocks),
            page.Section("Worn profiles and pressure", [_profiles(result)]),
            page.Section("Histories", _histories(result)),
            *_stresses(result),
            page.Section("The case", case),
            page.Section("Balances", [_errors(result)]),
            _reproduced(result),
        ],
    )


def _rig(result: Result) -> list[page.Block]:
    """Return the drawing of the rig, none where the stored text does not say the whole case.

    Laws are described as in the result: those in files of their own are not run.
    """
    if result.case.startswith(CHANGED):
        words = "The rig is not drawn: the case was changed in Python, its text does not say all."
        return [page.Lines([words])]
    try:
        keys = read_keys(result.case, result.name)
        bare = {key: value for key, value in keys.items() if not key.startswith("wear.")}
        case = make_case(bare, result.name)
    except InputError:  # of a version that had other keys
        return []
    lower, upper = (str(result.attributes.get(f"law_{body}") or "") for body in BODIES)
    alt = "Section of the rig through its axis: bodies, load, rotation, contact"
    drawing = rig_svg(case, (lower, upper))
    return [page.Pictures([page.Picture("The rig", drawing, page.SVG, alt)])]


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


def _profiles(result: Result) -> page.Block:
    """Return the charts of worn faces and pressure at five instants, as far as they are stored."""
    panels = []
    if run_panels.worn_bodies(result):
        panels.append(run_panels.worn_faces(result))
    if run_panels.at_all_states(result, "pressure"):
        panels.append(run_panels.pressure(result))
    if not panels:
        absence = "No profiles are stored at several times (output.fields, output.profiles)."
        return page.Lines([absence])
    return page.Pictures([
        page.chart(panel, f"Line chart: {panel.y.label} over the radius at several times", 4.0)
        for panel in panels
    ])  # fmt: skip


def _histories(result: Result) -> list[page.Block]:
    """Return the charts of the quantities over time, and which of them are constant."""
    charts, constant = list[page.Picture](), list[str]()
    for panel in run_panels.histories(result).values():
        if _is_level(panel):
            constant.append(panel.title)
        else:
            alt = f"Line chart: {panel.title} over {panel.x.label}"
            charts.append(page.chart(panel, alt))
    lines = [page.Lines([f"Constant, see the key numbers: {', '.join(constant)}."])]
    return [page.Pictures(charts), *(lines if constant else [])]


def _is_level(panel: Panel) -> bool:
    """Tell whether all curves of a panel are level lines."""
    return all(
        curve.y.size == 0 or float(np.ptp(curve.y)) <= _LEVEL * float(np.abs(curve.y).max())
        for curve in panel.curves
    )


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
    charts = []
    if "stress_grid" in stress:
        content = io.BytesIO()
        plot(result, "stress").savefig(content, format="png", dpi=150)
        alt = "Map of von Mises stress in the section"
        charts.append(page.Picture("Stress inside", content.getvalue(), "image/png", alt))
        charts.append(page.chart(along_height(result, "", last), "von Mises stress along z"))
    if any(f"interface_z_{body}" in stress for body in BODIES):
        charts += [
            page.chart(panel, f"Line chart: {panel.y.label}, {panel.title}")
            for panel in along_interfaces(result, "", last)
        ]
    if len(times) > 1:  # one is no history
        charts.append(page.chart(largest([result], [""]), "Largest von Mises stress over time"))
    rows = [
        (f"{time:.6g}", body, f"{top[t]:.5g}", f"{r[t]:.6g}", f"{z[t]:.6g}")
        for t, time in enumerate(times)
        for body in BODIES
        for top, r, z in [[stress[f"max_mises_{body}{end}"] for end in ("", "_r", "_z")]]
    ]
    header = ("time (s)", "ring", "von Mises (MPa)", "at r (mm)", "z (mm)")
    caption = f"Largest von Mises stress, {stress['stress_exclude']:g} mm and more from edges"
    table = page.Table(caption, header, rows, folded=len(rows) > _SHORT)
    blocks: list[page.Block] = [page.Pictures(charts)] if charts else []
    return [page.Section("Stress inside", [*blocks, table])]


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
