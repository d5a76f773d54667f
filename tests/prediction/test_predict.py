"""Predictions of a case that was not tested: from a fit and from its folder."""

import dataclasses
import json
import re

import numpy as np
import pytest
from laboratory import CASE, TRUTH, fit_tables, history, one_test, penetration, record
from mpi4py import MPI
from parts import law_names, main

import ringwear_par as rw
from ringwear_par.prediction import predict as module
from ringwear_par.prediction.known import doubts_of, fit_knowledge

FACTORS = (0.8, 1.0, 1.1, 1.3)
K = "wear.lower.k"
ADAPTIVE = {"time.scheme": "adaptive", "time.step": None, "time.steps": None}
ELSEWHERE = {**ADAPTIVE, "load.pressure": 110.0, "load.omega": 3.5, "time.end": 150.0}


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """The folder of a fit of four specimens, and the fit."""
    folder = tmp_path_factory.mktemp("fit")
    rng, experiments = np.random.default_rng(4), []
    for number, factor in enumerate(FACTORS, start=1):
        pressure = (45.0, 80.0)[number % 2]
        t, z = penetration(history(pressure, {**TRUTH, K: TRUTH[K] * factor}), rng)
        data = record(folder / f"z{number}.csv", t, z, nuisance={"offset": {}})
        experiments.append(one_test(f"test {number}", pressure, data))
    (folder / "case.toml").write_text(CASE)
    tables = fit_tables(folder, experiments)
    tables["fit"]["parameters"] = json.loads(json.dumps(tables["fit"]["parameters"]))
    tables["fit"]["parameters"][K]["scatter"] = "fit"
    fit = rw.fit(tables, MPI.COMM_SELF)
    fit.save(folder / "out")
    return folder / "out", fit


@pytest.fixture(scope="module")
def case(found):
    return rw.read_case(found[0].parent / "case.toml", ELSEWHERE)


def test_the_folder_knows_what_the_fit_knows(found, case):
    folder, fit = found
    of_folder, of_fit = (
        rw.predict(source, case, draws=8, seed=3, comm=MPI.COMM_SELF) for source in (folder, fit)
    )
    assert np.array_equal(of_folder.values, of_fit.values)
    for name, values in of_fit.histories.items():
        assert np.array_equal(of_folder.histories[name], values)
    dataset = of_folder.to_xarray()
    assert dataset.penetration.dims == ("draw", "step")


def test_a_specimen_is_known_better_than_the_material_and_the_next_one(found, case):
    _, fit = found
    at = {
        of: rw.predict(fit, case, of=of, draws=200, comm=MPI.COMM_SELF)
        for of in ("next specimen", "material", "test 1")
    }
    spread = {of: np.log(p.histories["penetration"][:, -1]).std() for of, p in at.items()}
    assert spread["next specimen"] > 1.3 * spread["material"]
    assert spread["material"] > 2.0 * spread["test 1"]
    entry = fit.to_dict()["parameters"][K]
    low, high = np.quantile(at["next specimen"].values[:, 0], (0.025, 0.975))
    assert np.log([low, high]) == pytest.approx(np.log(entry["next"]), abs=0.25)
    median = np.median(at["test 1"].values[:, 0])
    assert median == pytest.approx(entry["each"]["test 1"]["estimate"], rel=0.05)
    codes = [(d.code, d.values.get("condition")) for d in at["material"].doubts]
    beyond = [("extrapolates", name) for name in ("p", "pV", "distance")]
    assert codes == [*beyond, ("fit-warnings", None)]
    shorter = case.replace({"time.end": 0.01 * case.time.end})
    doubts = doubts_of(fit_knowledge(fit), shorter, "material")
    assert [d.values.get("condition") for d in doubts] == ["p", "pV", None]  # a part of a test
    drawn = np.random.default_rng(3).standard_normal((400, 200))  # mm; others of 200 each
    ends = np.quantile(drawn, (0.025, 0.975), axis=1).std(axis=1)
    penetration = np.quantile(drawn, np.arange(0.5, 200) / 200)[:, None]
    normal = dataclasses.replace(
        at["material"], histories={**at["material"].histories, "penetration": penetration}
    )
    (error,) = re.findall(r"uncertain by (\S+) um", normal.summary())
    assert float(error) == pytest.approx(1e3 * ends.mean(), rel=0.3)


def test_without_scatter_the_band_is_of_the_specimens_tested(found, case, monkeypatch):
    known = fit_knowledge(found[1])
    values = dataclasses.replace(
        known.values, scattering=known.values.scattering[:0], scatters=known.values.scatters[:, :0]
    )
    monkeypatch.setattr(
        module, "fit_knowledge", lambda _: dataclasses.replace(known, values=values)
    )
    both = [rw.predict(found[1], case, of=of, draws=2, comm=MPI.COMM_SELF)
            for of in ("next specimen", "test 2")]  # fmt: skip
    assert [one.whose for one in both] == ["the specimens tested", "test 2"]
    assert [one.doubts[0].code for one in both] == ["no-scatter", "one-value"]


def test_random_wear_spreads_a_prediction(found, case, monkeypatch):
    """Variance of worn depth: size times depth, where values are known."""
    _, fit = found
    size = 2e-5
    known = fit_knowledge(fit)
    parts = {name: getattr(known.values, name)[:1] for name in ("means", "scatters")}
    parts |= {"weights": np.ones(1), "covariances": 0.0 * known.values.covariances[:1]}
    parts |= {"sizes": np.array([[size, 0.0]])}
    known = dataclasses.replace(known, values=dataclasses.replace(known.values, **parts))
    monkeypatch.setattr(module, "fit_knowledge", lambda _: known)
    noisy = rw.predict(fit, case, of="test 2", draws=500, comm=MPI.COMM_SELF)
    depth = noisy.histories["worn_volume_lower"][:, [20, 40, -1]] / case.area
    parts["sizes"] = np.zeros((1, 2))
    known = dataclasses.replace(known, values=dataclasses.replace(known.values, **parts))
    plain = rw.predict(fit, case, of="test 2", draws=1, comm=MPI.COMM_SELF)
    mean = plain.histories["worn_volume_lower"][0, [20, 40, -1]] / case.area
    assert depth.mean(axis=0) == pytest.approx(mean, rel=0.04)
    assert depth.var(axis=0) == pytest.approx(size * mean, rel=0.27)


def test_what_is_refused(found, case, tmp_path):
    folder, fit = found
    design, interrupted = tmp_path / "design", tmp_path / "interrupted"
    design.mkdir()
    (design / "design.json").write_text("{}")
    (interrupted / "progress").mkdir(parents=True)
    other = case.replace({"wear.lower.law": "archard", "wear.lower.p0": None})
    for source, case_, options, said in (
        (tmp_path, case, {}, "fit.json"), (tmp_path / "none", case, {}, "exist"),
        (design, case, {}, "design"), (interrupted, case, {}, "interrupted"),
        (folder, tmp_path / "no.toml", {}, "no.toml"), (folder, other, {}, "wear.lower.law"),
        (fit, case, {"of": "S9"}, '"test 1", "test 2"'), (fit, case, {"draws": 0}, "draws"),
        (fit, case, {"seed": -1}, "seed"), ({}, case, {}, "dict"),
    ):  # fmt: skip
        with pytest.raises(rw.InputError, match=re.escape(said)):
            rw.predict(source, case_, comm=MPI.COMM_SELF, **options)


def test_names_tell_laws_of_layers_and_users_apart(case, tmp_path):
    layer = {"thickness": 2e-3, "young": 1e5, "poisson": 0.3, "wear": {"law": "archard", "k": 3e-9}}
    names = []
    for power in "12":
        (tmp_path / "law.py").write_text(f"def rate(p, v, k):\n    return k * p**{power} * v\n")
        law = {
            "wear.lower.law": "user",
            "wear.lower.file": str(tmp_path / "law.py"),
            "wear.lower.p0": None,
        }
        names.append(law_names(case.replace(law | {"lower.layers": [layer]})))
    assert [name["lower.layers[0].wear"] for name in names] == ["archard", "archard"]
    assert names[0]["wear.lower"].split()[0] == names[1]["wear.lower"].split()[0] == "user"
    assert names[0] != names[1]


def test_the_command(found, tmp_path, capsys):
    folder, _ = found
    out, case = tmp_path / "out", folder.parent / "case.toml"
    words = ["predict", str(folder), str(case), "--draws", "4", "--set", "load.pressure=60", "-o"]
    assert main([*words, str(out), "--depth", "1 um"]) == 0
    output = capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {
        "prediction.json", "prediction.h5", "prediction.png"
    }  # fmt: skip
    stored = json.loads((out / "prediction.json").read_text())
    assert stored["draws"] == 4
    (line,) = [line for line in stored["summary"] if line.startswith("1 um of penetration: ")]
    assert line in output
    assert stored["depth"]["reached"] == 1.0
    assert np.shape(stored["quantiles"]["penetration"]["values"]) == (len(stored["time"]), 5)
    assert "Prediction, 1 figure" in rw.report(out, tmp_path / "page.html")
    assert main([*words, str(folder)]) == 2
    assert "fit.json" in capsys.readouterr().err
