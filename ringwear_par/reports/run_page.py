"""The page of a run."""

import io
from collections.abc import Sequence

import numpy as np

from ringwear_par.cases.units import in_signs, with_signs
from ringwear_par.elasticity.boundary_fields import BODIES
from ringwear_par.reports import charts
from ringwear_par.reports.blocks import (
    Block,
    Lines,
    Page,
    Picture,
    Section,
    Source,
    Table,
    software,
)
from ringwear_par.reports.words import case_words
from ringwear_par.results.edge_elements import EDGE_ERROR
from ringwear_par.results.figures import plot
from ringwear_par.results.key_numbers import KeyNumbers, WornLayers, key_numbers
from ringwear_par.results.result import Result
from ringwear_par.results.variables import DISPLAY_UNITS, HISTORIES

_MICRO, _CUBIC = "\N{MICRO SIGN}m", "mm\N{SUPERSCRIPT THREE}"
_BALANCES = {
    "residual": "contact conditions (KKT residual)",
    "force": "contact pressure against the applied force",
    "volume": "worn profiles against the integrated rates",
    "energy": "worn volume against dissipated energy",
    "reaction": "force on the fixed faces against the contact's, vanishes with the mesh",
    "torque": "torque on the fixed faces against the contact's, vanishes with the mesh",
    "step_error": "estimated error of wear depth by time stepping, mm: over the whole history with "
    "adaptive steps, of one step with fixed ones; the mesh's error is not in it",
}
_TOLD = [v for name, v in HISTORIES.items() if name not in ("twist", "contact_iterations")]
#: panels of stresses, in words for those who do not see them
_STRESS_PANELS = {
    "stress": "map of von Mises stress in the section",
    "depth": "its course along the height",
    "mises": "the largest over time",
    "interfaces": "tractions along interfaces, von Mises stress on both sides",
}
#: instants of the table of histories
_INSTANTS = 21


def run_page(result: Result) -> Page:
    """Return the page of a run. Not collective.

    Raises
    ------
    InputError : the result was stored without its last state.
    """
    found = key_numbers(result)
    lines = with_signs(result.summary()).splitlines()
    title = str(result.attributes.get("title", ""))
    if title:
        del lines[0]
    doubts = [line for line in lines if line.startswith("WARNING")]
    blocks: list[Block] = [Lines(doubts, warning=True)] if doubts else []
    blocks.append(Lines([line for line in lines if line not in doubts]))
    blocks.append(Table("Key numbers, at the end", ("quantity", "value", "unit"), key_rows(found)))
    if found.bodies:
        blocks.append(worn_table(found))
    blocks += [_through(one.body, one.layers) for one in found.bodies if one.layers is not None]
    sections = [Section("Summary", blocks)]
    drawn = charts.profiles(result)
    told = "No profiles are stored at several times (output.fields, output.profiles)."
    sections.append(
        Section("Worn profiles and pressure", [Lines([told]) if drawn is None else drawn])
    )
    sections.append(Section("Histories", [charts.histories(result), _told(result)]))
    sections += _stresses(result)
    sections.append(Section("The case", case_words(result)))
    sections.append(Section("Balances", [_balances(result)]))
    sections.append(_reproduced(result))
    return Page("Wear history of a test", title or "Run without a title", sections)


def key_rows(found: KeyNumbers) -> list[Sequence[str]]:
    """Return the numbers of the summary, in as many digits."""
    element = "of an element"
    if found.largest_beside_edge:
        element += f" at the edge of contact, which may be off by {100.0 * EDGE_ERROR:.0f} %"
    rows: list[Sequence[str]] = [
        ("mean pressure, over the nominal annulus", f"{found.mean_pressure:.4g}", "MPa"),
        (f"largest pressure, {element}", f"{found.largest_pressure:.4g}", "MPa"),
        ("at the radius", f"{found.largest_at:.6g}", "mm"),
        ("smallest pressure", f"{found.smallest_pressure:.4g}", "MPa"),
        ("elements in contact", f"{found.touching}", ""),
    ]
    if found.sliding is not None:
        speed, p_v, distance = found.sliding
        rows += [
            ("sliding speed at the mean radius", f"{speed:.4g}", "mm/s"),
            ("p V at the mean radius", f"{p_v:.4g}", "MPa mm/s"),
            ("sliding distance at the mean radius", f"{distance:.4g}", "m"),
        ]
    rows.append(("penetration", f"{found.penetration:.6g}", _MICRO))
    if found.worn_off is not None:
        rows.append(("of it worn off", f"{found.worn_off:.6g}", _MICRO))
        rows.append(("of it elastic", f"{found.elastic:.3g}", _MICRO))
    return rows


def worn_table(found: KeyNumbers) -> Table:
    """Return what each body has lost, in the numbers of the summary."""
    header = (
        "body", f"deepest wear ({_MICRO})", f"worn volume ({_CUBIC})", "mass lost (mg)",
        f"mean rate ({_MICRO}/h)", f"rate at the end ({_MICRO}/h)",
        f"specific wear rate ({_CUBIC}/(N m))",
    )  # fmt: skip
    rows = [
        (
            one.body, f"{one.deepest:.6g}", f"{one.volume:.6g}",
            one.no_mass or _or_dash(one.mass, 6),
            _or_dash(one.rate, 4), _or_dash(one.rate_now, 4), _or_dash(one.specific, 4),
        )
        for one in found.bodies
    ]  # fmt: skip
    return Table("What has been worn off", header, rows)


def _through(body: str, layers: WornLayers) -> Table:
    """Return what has become of the layers of a body."""
    names = [f"layer {i}" for i in range(len(layers.volumes) - 1)] + ["the body itself"]
    rows = [
        (f"volume lost by {name}", f"{volume:.6g}", _CUBIC)
        for name, volume in zip(names, layers.volumes, strict=True)
    ]
    for one in layers.each:
        if one.layer < len(layers.volumes) - 2:
            through = f"layer {one.layer} worn through"
            rows.append((f"share of the contact area with {through}", f"{one.share:.4g}", ""))
            rows.append((f"{through} first at the radius", f"{one.r:.6g}", "mm"))
            rows.append((f"{through} there by", f"{one.time:.6g}", "s"))
    rows.append(("share of the contact area worn through", f"{layers.share:.4g}", ""))
    rows.append(("first worn through at", _or_dash(layers.time, 6), "s"))
    for one in layers.each:
        if one.layer == len(layers.volumes) - 2:
            rows.append(("first worn through at the radius", f"{one.r:.6g}", "mm"))
    rows.append(("least thickness left", f"{layers.thinnest:.4g}", _MICRO))
    rows.append(("largest thickness left", f"{layers.thickest:.4g}", _MICRO))
    return Table(f"Layers of {body}, at the end", ("quantity", "value", "unit"), rows)


def _told(result: Result) -> Table:
    """Return the histories at some instants, for those who do not see charts."""
    count = len(result.step)
    rows = np.unique(np.linspace(0, count - 1, _INSTANTS).round().astype(int)).tolist()
    units = [DISPLAY_UNITS.get(v.name, (v.unit, 1.0)) for v in _TOLD]
    both = list(zip(_TOLD, units, strict=True))
    header = [f"{v.name.replace('_', ' ')} ({in_signs(unit)})" for v, (unit, _) in both]
    table = [
        [f"{factor * result.histories[v.name][row]:.6g}" for v, (_, factor) in both] for row in rows
    ]
    caption = f"{len(rows)} of the {count} stored states as numbers"
    return Table(caption, header, table, folded=True)


def _or_dash(value: float | None, digits: int) -> str:
    return "\N{EN DASH}" if value is None else f"{value:.{digits}g}"


def _balances(result: Result) -> Table:
    off = result.balances
    rows = [
        (words, f"{off[name]:.1e}")
        for name, words in _BALANCES.items()
        if name in off and (name != "energy" or result.attributes.get("energy_identity"))
    ]
    caption = "Errors, the worst of all steps; relative, but for that of a time step"
    return Table(caption, ("what is held against what", "error"), rows)


def _stresses(result: Result) -> list[Section]:
    """Return the pictures of the stored stresses and the largest of them, nothing without."""
    if result.stress is None or not result.stress.states:
        return []
    states = result.stress.states
    there = {
        "stress": len(result.stress.grid[0]) > 0,
        "depth": len(result.stress.grid[0]) > 0,
        "mises": len(states) > 1,  # one is no history
        "interfaces": any(len(of.z) for of in result.stress.interfaces),
    }
    panels = [name for name in _STRESS_PANELS if there[name]]
    blocks: list[Block] = []
    if panels:
        content = io.BytesIO()
        plot(result, panels).savefig(content, format="png", dpi=150)
        alt = ", ".join(words for name, words in _STRESS_PANELS.items() if name in panels)
        blocks.append(Picture("Stress inside", content.getvalue(), "image/png", alt))
    rows = [
        (f"{state.time:.6g}", body, f"{of.mises:.5g}", f"{of.r:.6g}", f"{of.z:.6g}")
        for state in states
        for body, of in zip(BODIES, state.largest, strict=True)
    ]
    header = ("time (s)", "ring", "von Mises (MPa)", "at r (mm)", "z (mm)")
    caption = f"Largest von Mises stress, {result.stress.exclude:g} mm and more from edges"
    blocks.append(Table(caption, header, rows, folded=len(rows) > _INSTANTS))
    return [Section("Stress inside", blocks)]


def _reproduced(result: Result) -> Section:
    about = result.attributes
    ranks = int(about.get("ranks", 1))
    launched = f"mpirun -n {ranks} " if ranks > 1 else ""
    told = (
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
    names = [name for name in about if name == "version" or name.endswith("_version")]
    used = {name: str(about[name]) for name in [*names, "mpi_library"] if name in about}
    blocks: list[Block] = [Lines([f"{first}, then type:"]), Source("Commands", told)]
    blocks.append(software(used))
    rows = [("MPI ranks", str(ranks)), *((f"{k}, s", v) for k, v in seconds.items())]
    blocks.append(Table("Ranks, and seconds that it took", ("what", "value"), rows))
    return Section("How to reproduce", blocks)
