"""Figures: drawn from files alone, with axes that say what they show."""

import itertools
import re

import numpy as np
import pytest
from commands import ringwear
from mpi4py import MPI
from paths import PAPER

import ringwear_par as rw
from ringwear_par.errors import InputError
from ringwear_par.results.execution.run import run_case

pytestmark = pytest.mark.serial


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


@pytest.mark.parametrize("panels", ["wear,penetration", "pressure", "penetration,pressure,wear"])
@pytest.mark.parametrize("ending", [".png", ".pdf", ".svg"])
def test_every_panel_and_format(runs, tmp_path, panels, ending):
    from ringwear_par.pictures.figures import plot_files

    output = tmp_path / f"figure{ending}"
    plot_files(runs[:2], output, panels, "1,10,20")
    assert output.stat().st_size > 3000
    assert list(tmp_path.iterdir()) == [output]
    if ending == ".svg":
        text = output.read_text()
        assert text.count("<path") > 10


@pytest.mark.parametrize("by_command", [True, False])
def test_fonts_in_files_are_fonts(runs, tmp_path, by_command):
    """Publishers refuse Type 3; texts in drawings can be searched and edited."""
    from ringwear_par.pictures.figures import plot, plot_files

    pdf, svg = tmp_path / "figure.pdf", tmp_path / "figure.svg"
    for path in (pdf, svg):
        if by_command:
            plot_files(runs[:1], path)
        else:
            plot(runs[:1]).savefig(path)
    fonts = re.findall(rb"/Type\s*/Font\s*/Subtype\s*/(\w+)", pdf.read_bytes())
    assert b"Type0" in fonts
    assert b"Type3" not in fonts
    assert ">penetration depth (\N{MICRO SIGN}m)</text>" in svg.read_text(encoding="utf-8")


def test_what_libraries_note_of_a_picture_is_not_told(runs, tmp_path):
    done = ringwear("plot", runs[1], "-o", tmp_path / "figure.pdf")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_what_is_drawn_is_what_is_stored(runs):
    from ringwear_par.pictures.figures import plot
    from ringwear_par.results.storage.result_files import open_result

    figure = plot(runs[:2], "wear,penetration,pressure", "1,20", runs[1:2])
    wear, penetration, pressure = figure.axes
    result = open_result(runs[1])
    assert wear.lines[1].get_ydata() == pytest.approx(-1e3 * result.profiles["wear_lower"][20])
    assert pressure.lines[0].get_ydata() == pytest.approx(result.profiles["pressure"][1])
    assert pressure.lines[0].get_xdata() == pytest.approx(result.line.r)
    assert penetration.lines[1].get_ydata() == pytest.approx(1e3 * result.histories["penetration"])
    assert penetration.lines[1].get_xdata() == pytest.approx(result.histories["time"])
    assert wear.get_ylabel() == "height of worn face of lower (\N{MICRO SIGN}m)"
    assert pressure.get_ylabel() == "contact pressure (MPa)"
    assert penetration.get_xlabel() == "time (s)"
    assert penetration.lines[1].get_marker() == ""


def test_few_points_of_a_curve_are_marked(runs):
    from ringwear_par.pictures.figures import plot

    (penetration,) = plot(runs[2], "penetration").axes
    assert penetration.lines[0].get_marker() == "o"


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (("wear", "3,99"), "'99' is not a stored step"),
        (("wear", "x"), "'x' is not a stored step"),
        (("temperature", ""), "must be one of wear, pressure, section, stress, depth"),
        (("wear", "1", (), "5"), "--times: must be absent beside --steps"),
        (("wear", "", (), "30"), "'30' is no time of .* from 0 to 20 .s., or with a unit"),
        (("wear", "", (), "2 mm"), "'2 mm' is no time of"),
    ],
)
def test_wrong_requests(runs, tmp_path, arguments, match):
    from ringwear_par.pictures.figures import plot_files

    with pytest.raises(InputError, match=match):
        plot_files(runs[:1], tmp_path / "a.png", *arguments)
    assert not list(tmp_path.iterdir())


def test_wrong_files(runs, tmp_path):
    from ringwear_par.pictures.figures import plot_files

    with pytest.raises(InputError, match="does not hold pressure"):
        plot_files([runs[2]], tmp_path / "a.png", "pressure")
    with pytest.raises(InputError, match="its ending must be one of"):
        plot_files(runs, tmp_path / "a.docx")
    with pytest.raises(InputError, match="does not exist"):
        plot_files([tmp_path / "none.h5"], tmp_path / "a.png")
    with pytest.raises(InputError, match="not a result file"):
        plot_files([PAPER], tmp_path / "a.png")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("case", ["fields", "sphere", "crown", "coated"])
def test_deformed_sections(tmp_path, comm, case):
    from ringwear_par.pictures.figures import plot, plot_files
    from ringwear_par.results.storage.result_files import open_result

    run = tmp_path / "run.h5"
    words = ["mesh.contact_elements=16", "output.boundary=last"]
    words += {
        "fields": ["wear.upper={law='threshold', k=1e-8}"], "coated": ["time.end=50"],
        "crown": ["time.end=20"],
    }.get(case, ["time.steps=2"])  # fmt: skip
    run_case(PAPER.with_name(f"{case}.toml"), run, words, comm=comm)
    plot_files([run], tmp_path / "a.png", "section,pressure")
    assert (tmp_path / "a.png").stat().st_size > 3000
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
    assert (gap.max() > 0.01 * size) == (case in ("sphere", "crown"))
    told = axes.get_title()
    assert ("shape" in told) == (case in ("sphere", "crown"))
    assert ("layers 1\N{MULTIPLICATION SIGN}" in told) == (case == "coated")
    (colours,) = axes.collections
    p = state.bodies[0].pressure[state.bodies[0].face == 1]
    assert np.array_equal(np.sort(np.asarray(colours.get_array())), np.sort(p))


def test_magnification_is_round():
    from ringwear_par.pictures.sections import magnification

    assert magnification(np.inf) == 1.0
    assert magnification(100.0) == 100.0
    assert magnification(308.0) == 200.0  # nearest in logarithms
    assert magnification(0.8) == 1.0
    assert magnification(0.2) == pytest.approx(0.2)


def test_sections_need_boundary_fields(runs, tmp_path):
    from ringwear_par.pictures.figures import plot_files

    with pytest.raises(InputError, match=r"holds no fields .* output\.boundary"):
        plot_files(runs[:1], tmp_path / "a.png", "section")
    assert not list(tmp_path.iterdir())


def test_results_and_files_are_drawn_alike(runs, tmp_path):
    from ringwear_par.pictures.figures import plot
    from ringwear_par.pictures.style import save_figure
    from ringwear_par.results.storage.result_files import open_result

    first, second = map(open_result, runs[:2])
    sources = [[first, str(runs[1])], [runs[0], second], runs[:2]]
    drawn = []
    for number, several in enumerate(sources):
        figure = plot(several, ["wear", "penetration"], profiles_of=several[1:])
        assert len(figure.axes) == 2
        drawn.append(tmp_path / f"{number}.png")
        save_figure(figure, drawn[-1])
    assert len({path.read_bytes() for path in drawn}) == 1
    drawn.append(tmp_path / "plain.png")  # the figure takes its style along
    figure.savefig(drawn[-1], dpi=200)
    assert len({path.read_bytes() for path in drawn}) == 1
    alone = [plot(source, "penetration").axes[0] for source in (first, runs[0], str(runs[0]))]
    assert all(
        np.array_equal(axes.lines[0].get_ydata(), 1e3 * first.histories["penetration"])
        for axes in alone
    )
    with pytest.raises(InputError, match="must be one of the result files to be drawn"):
        plot([first], profiles_of=[second])


def test_results_without_a_file_have_a_name(runs):
    from dataclasses import replace

    from ringwear_par.pictures.figures import plot
    from ringwear_par.results.storage.result_files import open_result

    several = [replace(open_result(path), path=None) for path in (*runs[:1], runs[0], runs[2])]
    labels = [text.get_text() for text in plot(several, "penetration").axes[0].get_legend().texts]
    assert labels == ["result 1", "result 2", "result 3"]
    with pytest.raises(InputError, match="result in memory: does not hold pressure"):
        plot(several[2], "pressure")


def test_every_history_has_its_panel(runs):
    """What is drawn follows from what is stored: rates and p V are means between states."""
    from ringwear_par.pictures.figures import plot
    from ringwear_par.pictures.runs import HISTORY_PANELS
    from ringwear_par.results.storage.result_files import open_result

    result = open_result(runs[0])  # both bodies wear
    time, area = result.histories["time"], result.line.area.sum()
    panels = [name for name in HISTORY_PANELS if name != "through"]  # of layers
    drawn = dict(zip(panels, plot(runs[0], panels).axes, strict=True))
    for axes in drawn.values():
        assert axes.get_xlabel() == "time (s)"
        assert re.search(r"\(.+\)$", axes.get_ylabel())  # a unit
    force, torque = (drawn[name].lines[0].get_ydata() for name in ("force", "torque"))
    assert force == pytest.approx(result.histories["force"])
    assert torque == pytest.approx(1e-3 * result.histories["torque"])
    volumes = [line.get_ydata() for line in drawn["volume"].lines]
    for body, values in zip(("lower", "upper"), volumes, strict=True):
        assert values == pytest.approx(result.histories[f"worn_volume_{body}"])
    assert [t.get_text() for t in drawn["volume"].get_legend().texts] == ["lower", "upper"]
    rate = drawn["rate"].lines[0]
    depth = np.sum(rate.get_ydata()[1:] * np.diff(time)) / 3600.0
    assert depth == pytest.approx(1e3 * volumes[0][-1] / area)
    pressure, omega = 80.0, 3.541666666666667
    mean_radius = 30.0  # where all pressures are the same, p V is that at about the mean radius
    assert drawn["pv"].lines[0].get_ydata()[-1] == pytest.approx(
        1e-3 * pressure * omega * mean_radius, rel=0.01
    )


def test_profiles_at_times_are_those_of_the_nearest_states(runs):
    from ringwear_par.pictures.figures import plot
    from ringwear_par.results.storage.result_files import open_result

    result = open_result(runs[1])
    (axes,) = plot(runs[1], "pressure", times="0, 5.4, 0.25 min").axes
    for line, row in zip(axes.lines, (0, 5, 15), strict=True):
        assert line.get_ydata() == pytest.approx(result.profiles["pressure"][row])
    assert [t.get_text() for t in axes.get_legend().texts] == ["0 s", "5 s", "15 s"]


def test_times_without_a_stored_state_are_told(runs, caplog):
    """Of all that are drawn once, and only where it can be seen."""
    from ringwear_par.pictures.figures import plot

    plot(runs[2], "penetration")
    assert not caplog.messages
    plot(runs[1], "wear,pressure", times="5.04, 15.4, 0.25 min")
    (told,) = caplog.messages
    assert "--times 15.4: " in told
    assert told.endswith("p0_40.h5 has no state stored there; that of 15 s is shown")


def test_what_is_stored_is_drawn_beside_what_is_not(runs, caplog):
    from ringwear_par.pictures.figures import plot

    figure = plot(runs[:2], "wear,section,penetration")
    assert len(figure.axes) == 3  # two panels of wear
    told = [message.partition(" is not drawn: ") for message in caplog.messages]
    assert [panel for panel, _, _ in told] == ["section", "section"]
    assert all("holds no fields on the bodies' boundaries" in why for _, _, why in told)
    (axes,) = plot(runs[2], "wear,penetration,pressure").axes
    assert axes.get_ylabel().startswith("penetration")
    with pytest.raises(InputError, match="must be one of wear"):
        plot(runs[0], "wear,warmth")


def test_long_histories_are_drawn_in_hours(tmp_path, comm):
    from ringwear_par.pictures.figures import plot
    from ringwear_par.results.instants import time_unit

    run_case(
        PAPER, tmp_path / "a.h5",
        ["mesh.contact_elements=16", "time.steps=4", "time.step=1 h", "load.omega=0.01"],
        comm=comm,
    )  # fmt: skip
    wear, penetration = plot(tmp_path / "a.h5").axes
    assert penetration.get_xlabel() == "time (h)"
    assert penetration.lines[0].get_xdata() == pytest.approx(np.arange(5.0))
    assert wear.get_legend().texts[-1].get_text() == "4 h"
    assert [time_unit(end)[0] for end in (7200.0, 7201.0, 8 * 86400.0)] == ["s", "h", "days"]


def test_panels_of_several_results_have_one_scale(runs):
    from ringwear_par.pictures.figures import plot

    figure = plot(runs[:2], "wear,pressure")
    for pair in (figure.axes[:2], figure.axes[2:]):
        assert len({axes.get_ylim() for axes in pair}) == 1
        for axes in pair:
            values = np.concatenate([line.get_ydata() for line in axes.lines])
            assert axes.get_ylim()[0] <= values.min()


@pytest.mark.parametrize("panels", ["wear,pressure", "penetration,volume", "rate,pv"])
def test_legends_cover_nothing(runs, panels):
    """They stand above their panel, within the picture, and no two letters overlap."""
    from ringwear_par.pictures.figures import plot

    figure = plot(runs[:2], panels)
    figure.canvas.draw()
    boxes = []
    for axes in figure.axes:
        legend = axes.get_legend().get_window_extent()
        assert legend.y0 >= axes.get_window_extent().y1
        assert figure.bbox.x0 <= legend.x0
        assert legend.x1 <= figure.bbox.x1
        boxes.append(legend)
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))


def test_values_are_told_in_a_few_words():
    from ringwear_par.pictures.style import in_words

    assert in_words(80.0) == "80"
    assert in_words([[0.0, 50.0], [5.0, 60.0], [9.0, 80.0]]) == "50 to 80 in 3 points"
    assert in_words([[0.0, 5.0], [9.0, 8.0]], "MPa") == "5 to 8 MPa in 2 points"
    assert in_words({"crown": 500.0}) == "crown 500 mm"
    assert in_words({"cone": 1.0}) == "cone 1 deg"
    assert in_words({"r": [[10, 1e-7], [20, 2e-7]]}) == "profile of 2 radii"
    assert in_words("archard") == "archard"


def test_stages_in_time_stay_apart_in_grey():
    """Lightness falls from the first to the last, whatever colours are to somebody's eyes."""
    from matplotlib.colors import to_rgb

    from ringwear_par.pictures.style import COLOURS, stage_colour

    def lightness(colour):
        return float(np.dot((0.2126, 0.7152, 0.0722), np.square(to_rgb(colour))))

    stages = [lightness(stage_colour(number, 5)) for number in range(5)]
    assert all(before > 1.5 * after for before, after in itertools.pairwise(stages))
    assert stages[0] < 0.75  # on white paper
    assert len({round(lightness(colour), 3) for colour in COLOURS}) == len(COLOURS)


def test_a_history_of_one_state_has_no_rate(runs):
    from dataclasses import replace

    from ringwear_par.pictures.figures import plot
    from ringwear_par.results.storage.result_files import open_result

    whole = open_result(runs[1])
    first = {name: values[:1] for name, values in whole.histories.items()}
    begun = replace(whole, histories=first, step=whole.step[:1], steps_made=whole.steps_made[:1])
    figure = plot(begun, "rate,pv,volume")
    assert [len(axes.lines) for axes in figure.axes] == [0, 0, 1]


def test_what_the_common_scale_shows_is_not_cut(tmp_path, comm):
    from ringwear_par.pictures.figures import plot

    for name, pressure in (("low", 5), ("high", 80)):
        words = ["mesh.contact_elements=32", "time.steps=1", f"load.pressure={pressure}"]
        run_case(PAPER, tmp_path / f"{name}.h5", words, comm=comm)
    low, high = plot([tmp_path / "low.h5", tmp_path / "high.h5"], "pressure", "0").axes
    titles = [axes.get_legend().get_title().get_text() for axes in (low, high)]
    for axes, title in zip((low, high), titles, strict=True):
        cut = max(line.get_ydata().max() for line in axes.lines) > axes.get_ylim()[1]
        assert ("peak of" in title) == cut
    assert "peak of" in titles[1]


def test_the_peak_of_pressure_is_the_same_everywhere(tmp_path, comm):
    from ringwear_par.explorer.figures import Drawing
    from ringwear_par.pictures.figures import plot
    from ringwear_par.reports.run_page import profiles
    from ringwear_par.results.instants import pressure_peak
    from ringwear_par.results.storage.result_files import open_result

    words = ["mesh.contact_elements=32", "time.steps=8"]
    run_case(PAPER, tmp_path / "a.h5", words, comm=comm)
    result = open_result(tmp_path / "a.h5")
    pressure = result.profiles["pressure"]
    assert pressure.max(axis=1).argmax() == 0  # of no stage
    note = f"peak of {pressure.max():.4g} MPa at 0 s not shown"
    for words in ({}, {"steps": "8"}, {"steps": "0"}):
        (axes,) = plot(result, "pressure", **words).axes
        assert axes.get_legend().get_title().get_text().endswith(f"\n{note}")
    chart = profiles(result).charts[-1]
    assert chart.caption == f"contact pressure (MPa), {note}"
    told = Drawing(result, result, None, 1.0, "volume", []).columns()["pressure"]
    assert told["note"] == note
    assert told["ranges"][1] == [*chart.panel.y.ends]
    assert told["ranges"][1][1] == pytest.approx(pressure_peak(result).limit)


def test_times_and_numbers_are_spelled_once():
    from ringwear_par.results.instants import number_words, stages, time_words

    assert [time_words(1000.0, 7200.0), time_words(12345.0, 2e6)] == ["1000 s", "0.1429 days"]
    assert time_words(5400.0, 7201.0) == "1.5 h"
    assert [number_words(v) for v in (0.34567, 80.0, 2706.6, 12345.6)] == [
        "0.3457", "80", "2707", "12346"
    ]  # fmt: skip
    assert stages(np.linspace(0.0, 8.0, 9)) == [1, 2, 4, 6, 8]
    assert stages(np.array([0.0])) == [0]


@pytest.mark.serial
def test_elements_at_the_edge_of_contact_are_marked():
    """Those that bear load beside one that does not, at each drawn state."""
    keys = {"mesh.contact_elements": 16, "mesh.grading": 1.0, "time.end": 60.0}
    case = rw.read_case(PAPER.with_name("crown.toml"), keys)
    result = rw.simulate(case, MPI.COMM_SELF)
    (axes, *_) = rw.plot(result, "pressure", steps=f"0,{result.step[-1]}").axes
    marked = [line for line in axes.lines if line.get_marker() == "o"]
    assert len(marked) == 2
    for line, row in zip(marked, (0, -1), strict=True):
        pressure = result.profiles["pressure"][row]
        closed = np.flatnonzero(pressure > 0.0)
        assert 0 < closed[0] < closed[-1] < 15
        assert line.get_xdata().tolist() == result.line.r[[closed[0], closed[-1]]].tolist()
        assert line.get_ydata().tolist() == pressure[[closed[0], closed[-1]]].tolist()
