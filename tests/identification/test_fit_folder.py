"""``ringwear fit`` and the folder that it writes: numbers, tables, draws, dry runs."""

import json

import h5py
import numpy as np
import pytest
import xarray
from laboratory import TRUTH
from parts import Draws, main, read_draws, toml_text

from ringwear_par.identification.fit import run_fit
from ringwear_par.identification.fitted_tests import readings_of_draws

K = "wear.lower.k"


@pytest.fixture(scope="module")
def folder(found, tmp_path_factory):
    """The folder of a fit without scatter."""
    folder = tmp_path_factory.mktemp("folder") / "fit"
    found.save(folder)
    return folder


@pytest.mark.slow
def test_a_command_writes_nothing_in_a_dry_run(tables, comm, capsys, tmp_path):
    """Which says what is to be expected, that of the fit if its starts are the truth."""
    path, folder = tmp_path / "fit.toml", tmp_path / "out"
    given = tables()
    for key, value in TRUTH.items():
        given["fit"]["parameters"][key]["start"] = value
    path.write_text(toml_text(given))
    run_fit(path, folder, comm, dry_run=True)
    output = capsys.readouterr().out
    assert "to be expected" in output
    assert not folder.exists()
    (line,) = (line.split() for line in output.splitlines() if f"  {K} " in line)
    assert (line[1], line[3]) == ("sd", "%")
    assert main(["fit", str(path), "-o", str(folder)]) == 0
    assert "wear.lower.p0" in capsys.readouterr().out
    k = json.loads((folder / "fit.json").read_text())["parameters"][K]
    assert 0.01 * float(line[2]) == pytest.approx(k["sd"] / k["estimate"], rel=0.15)


def test_what_is_written(folder, found):
    assert sorted(p.name for p in folder.iterdir()) == [
        "draws.nc", "fit.json", "fit.png", "results.h5",
    ]  # fmt: skip
    stored = json.loads((folder / "fit.json").read_text())
    assert stored == json.loads(json.dumps(found.to_dict()))
    assert {"parameters", "covariance", "chi2", "p_value", "evidence", "process",
            "experiments", "nuisance", "inputs", "checks", "doubts", "alternatives",
            "draws"} <= {*stored}  # fmt: skip
    assert stored["warnings"] == [doubt["text"] for doubt in stored["doubts"]]
    with h5py.File(folder / "results.h5") as file:
        groups = {name: group for name, group in file.items() if "experiment" in group.attrs}
        assert len(groups) == 4
        for group in groups.values():
            series = group.attrs["experiment"], group.attrs["series"]
            chi2 = stored["experiments"][series[0]][series[1]]["chi2"]
            assert (group["residual"][:] ** 2).sum() == pytest.approx(chi2)
            rest = (group["data"][:] - group["model"][:]) / group["sd"][:]
            np.testing.assert_allclose(rest, group["residual"][:], atol=1e-9)
    with xarray.open_dataset(folder / "results.h5", group=next(iter(groups)),
                             engine="h5netcdf") as opened:  # fmt: skip
        assert opened["data"].attrs["units"] == "mm"


def test_tables_for_spreadsheets(folder, tmp_path):
    """They have the numbers of the fit."""
    openpyxl = pytest.importorskip("openpyxl")
    stored = json.loads((folder / "fit.json").read_text())
    assert main(["export", str(folder), "-o", str(tmp_path / "fit.xlsx")]) == 0
    book = openpyxl.load_workbook(tmp_path / "fit.xlsx")
    header, k, *_ = book["parameters"].iter_rows(values_only=True)
    k = dict(zip(header, k, strict=True))
    assert (k["key"], k["unit"]) == (K, "1/MPa")
    assert [k["from"], k["to"]] == pytest.approx(stored["parameters"][K]["interval"])
    header, *readings = book["readings"].iter_rows(values_only=True)
    place = header.index("residual over noise")
    chi2 = sum(one["chi2"] for of in stored["experiments"].values() for one in of.values())
    assert sum(row[place] ** 2 for row in readings) == pytest.approx(chi2)


def test_replicas_are_about_as_far_off_as_the_readings(found):
    """And log p of the readings is about that of their residuals, and of bands that widen them."""
    logs, replicas = readings_of_draws(found.solution, 0, np.random.default_rng(0))
    of_test = [one for one in found.series if one.test == "test 1"]
    model, sd, band = (
        np.concatenate([one.series.factor * getattr(one.drawn, name) for one in of_test])
        for name in ("model", "sd", "band")
    )
    residuals = np.concatenate([one.drawn.residuals for one in of_test])
    off = (replicas - model) / np.hypot(sd, band)
    assert abs(off.mean()) < 0.02
    assert off.std() == pytest.approx(1.0, abs=0.03)
    squares = residuals**2 + (band / sd) ** 2
    expected = -0.5 * squares - np.log(sd) - 0.5 * np.log(2.0 * np.pi)
    assert logs.mean(axis=0) == pytest.approx(expected, abs=0.15)


@pytest.mark.slow
def test_draws_are_read_as_they_were_written(specimens, tmp_path):
    """ArviZ has them by chains."""
    specimens.save(tmp_path)
    again, draws = read_draws(tmp_path / "draws.nc"), specimens.draws
    for name in Draws.__dataclass_fields__:
        one, other = getattr(again, name), getattr(draws, name)
        if isinstance(other, np.ndarray):
            np.testing.assert_allclose(one, other, rtol=1e-12)
        elif name in ("tests", "scatter", "process"):
            assert [*one] == [*other]
            np.testing.assert_array_equal([*one.values()], [*other.values()])
        else:
            assert one == other, name
    count, n = len(draws), specimens.content["n_data"]
    with h5py.File(tmp_path / "draws.nc") as file:
        assert {*file} == {"posterior", "observed_data", "posterior_predictive", "log_likelihood"}
        assert file["posterior"][K].shape == (4, count // 4)
        assert file["posterior"]["process.wear.lower"].attrs["units"] == "mm"
        assert file["log_likelihood"]["reading"].shape == (4, count // 4, n)
        assert file["posterior_predictive"]["reading"].shape == (4, count // 4, n)
        observed = file["observed_data"]["reading"][:]
    read = [one.series.value for one in specimens.series]
    np.testing.assert_array_equal(observed, np.concatenate(read))
