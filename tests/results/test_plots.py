"""Figures: drawn from files alone, with axes that say what they show."""

import re

import numpy as np
import pytest
from figure_texts import check_texts
from parts import HISTORY_PANELS, plot, plot_stored
from paths import PAPER

import ringwear_par as rw
from ringwear_par.results.files import open_result
from ringwear_par.results.run import run_case


@pytest.fixture(scope="module")
def runs(tmp_path_factory, comm):
    folder = tmp_path_factory.mktemp("runs")
    paths = [folder / "p0_0.h5", folder / "p0_40.h5", folder / "lean.h5"]
    extra = [
        ["wear.lower.p0=0", "wear.upper.law=threshold", "wear.upper.k=1e-8"],
        [],
        ["output.fields=['gap']", "output.every=7"],
    ]
    for path, overrides in zip(paths, extra, strict=True):
        overrides = ["mesh.contact_elements=16", "time.steps=20", *overrides]
        run_case(PAPER, path, overrides, comm=comm)
    return paths


def test_fonts_in_files_are_fonts(runs, tmp_path):
    """Publishers refuse Type 3; texts in drawings can be searched and edited."""
    pdf, svg = tmp_path / "figure.pdf", tmp_path / "figure.svg"
    for path in (pdf, svg):
        plot_stored(runs[:1], path)
    fonts = re.findall(rb"/Type\s*/Font\s*/Subtype\s*/(\w+)", pdf.read_bytes())
    assert b"Type0" in fonts
    assert b"Type3" not in fonts
    assert ">penetration depth (\N{MICRO SIGN}m)</text>" in svg.read_text(encoding="utf-8")


def test_what_is_drawn_is_what_is_stored(runs):
    figure = plot(runs[:2], "wear,penetration,pressure", "1,20")
    _, wear, penetration, _, pressure = figure.axes
    result = open_result(runs[1])
    assert wear.lines[1].get_ydata() == pytest.approx(1e3 * result.profiles["wear_lower"][20])
    assert pressure.lines[0].get_ydata() == pytest.approx(result.profiles["pressure"][1])
    assert pressure.lines[0].get_xdata() == pytest.approx(result.line.r)
    assert penetration.lines[1].get_ydata() == pytest.approx(1e3 * result.histories["penetration"])
    assert penetration.lines[1].get_xdata() == pytest.approx(result.histories["time"])
    assert wear.get_ylabel() == "worn depth of lower (\N{MICRO SIGN}m)"
    assert wear.yaxis_inverted()  # as in figures of fits
    (axes,) = plot(runs[1], "pressure", times="0, 5.4, 0.25 min").axes
    for line, row in zip(axes.lines, (0, 5, 15), strict=True):  # the nearest states
        assert line.get_ydata() == pytest.approx(result.profiles["pressure"][row])
    assert [t.get_text() for t in axes.get_legend().texts] == ["0 s", "5 s", "15 s"]


def test_wrong_files(runs, tmp_path):
    text = tmp_path / "notes.h5"
    text.write_text("notes")
    for source, panel, word in ((runs[2], "pressure", "pressure"), (text, "wear", "not a result"),
                                (runs[0], "wear,warmth", "warmth")):  # fmt: skip
        with pytest.raises(rw.InputError, match=word):
            plot_stored([source], tmp_path / "a.png", panels=panel)
    assert list(tmp_path.iterdir()) == [text]


@pytest.mark.parametrize("case", ["fields", "crown", "coated"])
def test_deformed_sections(tmp_path, comm, case):
    run = tmp_path / "run.h5"
    words = ["mesh.contact_elements=16", "output.boundary=last"]
    words += {
        "fields": ["wear.upper={law='threshold', k=1e-8}"], "coated": ["time.end=50"],
        "crown": ["time.end=20"],
    }[case]  # fmt: skip
    run_case(PAPER.with_name(f"{case}.toml"), run, words, comm=comm)
    axes = plot(run, ["section"]).axes[0]
    assert axes.get_aspect() == 1.0
    assert "mm" in axes.get_xlabel()
    shown = [patch.get_xy()[:-1] for patch in axes.patches]
    state = open_result(run).boundary[-1]
    zones = [(body, at) for body in state.bodies for at in body.contours]
    for drawn, (body, at) in zip(shown, zones, strict=False):
        assert drawn == pytest.approx(body.nodes[at])
    # displacement, wear and shape are magnified alike: so are gaps, and what touches does
    height = []
    first = [shown[len(zones)], shown[len(zones) + len(state.bodies[0].contours)]]
    for outline, body in zip(first, state.bodies, strict=True):
        middle = body.elements[body.face == 1, 1]
        height.append(outline[middle[body.nodes[middle, 0].argsort()], 1])
    result = open_result(run)
    size = float(np.ptp(np.concatenate([body.nodes for body in state.bodies]), axis=0).max())
    factor = float(axes.get_title().splitlines()[1].split()[-1][:-1])
    gap = factor * result.profiles["gap"][-1]
    assert height[1] - height[0] == pytest.approx(gap, abs=3e-3 * size)
    assert (gap.max() > 0.01 * size) == (case == "crown")
    (colours,) = axes.collections
    p = state.bodies[0].pressure[state.bodies[0].face == 1]
    assert np.array_equal(np.sort(np.asarray(colours.get_array())), np.sort(p))


def test_every_history_has_its_panel(runs):
    """What is drawn follows from what is stored: rates are means between states."""
    result = open_result(runs[0])  # both bodies wear
    time, area = result.histories["time"], result.line.area.sum()
    panels = [name for name in HISTORY_PANELS if name != "through"]  # of layers
    drawn = dict(zip(panels, plot(runs[0], panels).axes, strict=True))
    for name, axes in drawn.items():
        assert axes.get_xlabel() == "time (s)"
        assert name == "friction" or re.search(r"\(.+\)$", axes.get_ylabel())  # a unit
    volumes = [line.get_ydata() for line in drawn["volume"].lines]
    p_v = result.to_xarray().pressure_velocity.values  # one quantity in tables and figures
    for values, exact in (
        (drawn["force"].lines[0].get_ydata(), result.histories["force"]),
        (drawn["torque"].lines[0].get_ydata(), 1e-3 * result.histories["torque"]),
        (drawn["pv"].lines[0].get_ydata(), p_v),
        (volumes, [result.histories[f"worn_volume_{body}"] for body in ("lower", "upper")]),
    ):
        np.testing.assert_allclose(values, exact)
    assert [t.get_text() for t in drawn["volume"].get_legend().texts] == ["lower", "upper"]
    depth = np.sum(drawn["rate"].lines[0].get_ydata()[1:] * np.diff(time)) / 3600.0
    assert depth == pytest.approx(1e3 * volumes[0][-1] / area)


@pytest.mark.parametrize("width", [None, 90.0])
def test_no_text_covers_another(runs, width):
    for panels in ("wear,pressure", "wear,rate,pressure,energy"):
        figure = plot(runs[:2], panels, width=width)
        check_texts(figure)
        assert width is None or 25.4 * figure.get_figwidth() == pytest.approx(width)
