"""The page of a measurement, from what its folder holds."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ringwear_par.cases.units import SPECIFIC, in_signs, with_signs
from ringwear_par.errors import legible
from ringwear_par.files import folders
from ringwear_par.measuring import measure_numbers as numbers
from ringwear_par.measuring.figures import panels
from ringwear_par.reports import blocks as page
from ringwear_par.reports.fit_page import stored_outcome

_DASH = "\N{EN DASH}"
#: entry of a standard's form for what no file of a rig has
_OPEN = "not in the files; to be added by hand"
#: most tiles of a page
_MOST_TILES = 6
_BUDGETS = {
    "specific_wear_rate": "specific wear rate of the steady part",
    "friction": "friction coefficient",
    "whole": "specific wear rate of the whole test, by weighing",
}


def measure_page(folder: Path) -> page.Page:
    """Return the page of the folder of a measurement. Not collective.

    Raises
    ------
    InputError : it is damaged.
    """
    with stored_outcome(folder / folders.MEASURE, "the outcome of ringwear measure") as outcome:
        sections = [
            page.Section("Summary", list(_summary(outcome))),
            page.Section("Records", [_records(outcome)]),
            page.Section("Wear, in the form of ASTM C808", _wear(outcome)),
            page.Section("Friction, in the form of ASTM G115", _friction(outcome)),
            page.Section("Budgets of uncertainty", [_method(), *_budgets(outcome)]),
            _reproduced(outcome),
        ]
    title = f"Measured: {legible(folder.resolve().name)}"
    return page.Page("Measurement of wear and friction", title, sections)


def _summary(outcome: Mapping[str, Any]) -> Iterator[page.Block]:
    tests = outcome["tests"]
    sentences = [
        f"Specific wear rate {numbers.repeats_text(repeats)}" for repeats in outcome["repeats"]
    ]
    if not sentences:
        sentences = ["Numbers of these specimens only: repeats of a material scatter more"]
    yield _tiles(outcome)
    yield page.Lines([with_signs(sentence) for sentence in sentences])
    rows = [
        [name, _bare(rate := entry["specific_wear_rate"]), _bare(rate and rate["us"]),
         _bare(entry["wear_rate"], 3.6e6), _bare(entry["friction"]), numbers.steady_text(entry)]
        for name, entry in tests.items()
    ]  # fmt: skip
    header = ("test", "specific wear rate (mm\u00b3/(N m))", "in in\u00b3 min/(ft lbf h)",
              "wear rate (\u00b5m/h)", "friction", "part of the test")  # fmt: skip
    yield page.Table("Tests, with intervals of 95 %: the value less and plus 2 u", header, rows)
    doubts = [
        with_signs(f"{name}: {doubt['text']}")
        for name, entry in tests.items()
        for doubt in entry["doubts"]
    ]
    if doubts:
        yield page.Lines(doubts, warning=True)
    notes = [
        *outcome["notes"],
        *(f"{name}: {note}" for name, entry in tests.items() for note in entry["notes"]),
        *(f"{name}: skipped {skipped}" for name, entry in tests.items()
          if (skipped := numbers.skipped_text(entry))),
    ]  # fmt: skip
    if notes:
        yield page.Lines([with_signs(note) for note in notes])


def _tiles(outcome: Mapping[str, Any]) -> page.Tiles:
    """Return the specific wear rates: means of repeats, and tests that are none."""
    rates = [
        (
            ", ".join(repeats["tests"]),
            repeats["specific_wear_rate"]["mean"],
            repeats["specific_wear_rate"],
        )
        for repeats in outcome["repeats"]
    ]
    repeated = {name for repeats in outcome["repeats"] for name in repeats["tests"]}
    for name, entry in outcome["tests"].items():
        if name not in repeated and (rate := entry["specific_wear_rate"]) is not None:
            rates.append((name, rate["value"], rate))
    tiles = [
        page.Tile(
            f"specific wear rate of {names}", f"{value:.3g}", in_signs(SPECIFIC),
            "{:.3g} to {:.3g} (95 %)".format(*rate["interval"]),
        )
        for names, value, rate in rates
    ]  # fmt: skip
    doubts = sum(len(entry["doubts"]) for entry in outcome["tests"].values())
    return page.Tiles([*tiles[:_MOST_TILES], page.checks_tile(doubts)])


def _records(outcome: Mapping[str, Any]) -> page.Pictures:
    """Return the charts of all records."""
    return page.Pictures([
        page.chart(panel, f"Line chart: {panel.y.label} over time, {panel.title}")
        for name, entry in outcome["tests"].items()
        for panel in panels(name, entry).values()
    ])  # fmt: skip


def _wear(outcome: Mapping[str, Any]) -> list[page.Block]:
    tests = outcome["tests"]
    first = next(iter(tests.values()))["conditions"]
    conditions = page.Table(
        "Rig and specimens", ("item", "value"),
        [
            ("contact", f"annulus of radii {first['radii'][0]:g} to {first['radii'][1]:g} mm"),
            ("nominal area", f"{first['area']:.4g} mm\u00b2"),
            ("mean radius", f"{first['mean_radius']:.4g} mm"),
            ("specimen that wears", str(first["body"])),
            ("density of this specimen", _DASH if first["density"] is None
             else f"{first['density']:g} g/mm\u00b3"),
            ("materials, treatment, roughness of both", _OPEN),
            ("atmosphere, humidity, lubricant, cleaning", _OPEN),
        ],
    )  # fmt: skip
    quantities = [quantity for quantity in numbers.QUANTITIES if quantity is not numbers.FRICTION]
    rows = [("part of the test", _cells(tests, numbers.steady_text)), *_rows(tests, quantities)]
    return [conditions, _by_test("Conditions and wear of each test", tests, rows)]


def _friction(outcome: Mapping[str, Any]) -> list[page.Block]:
    tests = outcome["tests"]
    rows = [
        *_rows(tests, [numbers.FRICTION], "kinetic friction coefficient"),
        ("it is of", _cells(tests, numbers.steady_text)),
        ("steady by itself from (h)", _cells(tests, lambda e: _DASH
                                            if e["steady_from"]["friction"] is None
                                            else f"{e['steady_from']['friction'] / 3600.0:.3g}")),
        *_rows(tests, [numbers.LOAD, numbers.SPEED, *numbers.TEMPERATURES]),
        ("static friction coefficient", _cells(tests, lambda e: _OPEN)),
    ]  # fmt: skip
    sentence = (
        "Friction is torque over load and mean radius, 2/3 (b\u00b3 - a\u00b3)/(b\u00b2 - a\u00b2),"
        " as a mean over the part. The rig and the specimens are as above."
    )
    return [page.Lines([sentence]), _by_test("Friction of each test", tests, rows)]


def _by_test(
    caption: str, tests: Mapping[str, Any], rows: Sequence[tuple[str, list[str]]]
) -> page.Table:
    return page.Table(caption, ("quantity", *tests), [(name, *cells) for name, cells in rows])


def _rows(
    tests: Mapping[str, Any], quantities: Sequence[numbers.Quantity], name: str = ""
) -> list[tuple[str, list[str]]]:
    """Return rows of quantities, of a name or their own, with the unit."""
    return [
        (
            name or f"{quantity.name} ({in_signs(quantity.unit)})",
            [quantity.text(entry) or _DASH for entry in tests.values()],
        )
        for quantity in quantities
    ]


def _cells(tests: Mapping[str, Any], cell: Any) -> list[str]:
    return [str(cell(entry)) for entry in tests.values()]


def _method() -> page.Lines:
    return page.Lines(
        [
            "u: standard uncertainty; type A: from the scatter of readings, whose autocorrelation "
            "counts; type B: otherwise (JCGM 100:2008)",
            "steadiness: what the rate or the level may change by within the part",
            "Monte Carlo: the shortest interval of 95 % of 200 000 draws (JCGM 101:2008)",
            "no budget has uncertainties that are not in measure.uncertainty of the measure file",
        ]
    )


def _budgets(outcome: Mapping[str, Any]) -> Iterator[page.Table]:
    for name, entry in outcome["tests"].items():
        for key, words in _BUDGETS.items():
            value = entry["whole"]["specific_wear_rate"] if key == "whole" else entry[key]
            if value is None:
                continue
            rows = [
                (row["source"], row["type"], f"{row['u']:.3g}", in_signs(row["unit"]),
                 f"{row['sensitivity']:.3g}", f"{abs(row['sensitivity']) * row['u']:.2g}",
                 f"{100 * row['share']:.1f}")
                for row in value["budget"]
            ]  # fmt: skip
            caption = f"{name}: {words}, {with_signs(numbers.entry_text(value))}"
            if "monte_carlo" in value:
                low, high = value["monte_carlo"]
                caption += f"; Monte Carlo {low:.4g} to {high:.4g}"
            header = (
                "source",
                "type",
                "u",
                "unit",
                "sensitivity",
                "contribution",
                "share of u\u00b2 (%)",
            )
            yield page.Table(caption, header, rows, folded=True)


def _reproduced(outcome: Mapping[str, Any]) -> page.Section:
    commands = (
        "ringwear measure measure.toml -o out/measure\nringwear report out/measure -o report.html\n"
    )
    first = "Save the measure file as measure.toml beside its case and its records, then type:"
    source = page.Source("Measure file", outcome["measure_file"])
    return page.reproduced(first, commands, [source], outcome["versions"], data=outcome["data"])


def _bare(entry: Mapping[str, Any] | None, factor: float = 1.0) -> str:
    """Return an entry of measure.json with its uncertainty, without its unit."""
    return _DASH if entry is None else numbers.entry_text(entry, factor, "")
