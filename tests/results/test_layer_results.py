"""Results of bodies with layers: variables, words, tables, pictures, sweeps."""

import csv

import numpy as np
import pytest
from mpi4py import MPI
from parts import plot
from paths import CASES

import ringwear_par as rw
from ringwear_par.results.export import export
from ringwear_par.results.key_numbers import key_numbers

CASE = CASES / "wear_through.toml"
LAYER = {"thickness": 0.003, "young": 10e3, "poisson": 0.3}
SMALL = {
    "mesh.contact_elements": 16, "time.scheme": "implicit", "time.end": None, "time.step": 10.0,
    "time.steps": 9,
}  # fmt: skip


@pytest.fixture(scope="module")
def case():
    """Two layers below, one above, whose volumes have dimensions of their own."""
    below = [{**LAYER, "thickness": 5e-4, "density": "1.2 g/cm3"}, LAYER]
    upper = {"upper.layers": [{**LAYER, "wear": {"law": "archard", "k": 1e-10}}]}
    return rw.read_case(CASE, {"lower.layers": below, **upper, **SMALL})


@pytest.fixture(scope="module")
def result(case):
    return rw.simulate(case, MPI.COMM_SELF)


def test_variables_of_layers_are_those_of_the_contract(result, tmp_path):
    result.save(tmp_path / "run.h5")
    data = rw.open_result(tmp_path / "run.h5").to_xarray()
    assert data.equals(result.to_xarray())
    np.testing.assert_array_equal(data.attrs["density_lower_layers"], [1.2e-3, np.nan])
    assert data["worn_volume_lower_layers"].dims == ("step", "layer")
    assert data["worn_volume_upper_layers"].dims == ("step", "layer_upper")
    assert data["layer_left_lower"].dims == ("step", "element")
    assert data["share_through_lower"].dims == ("step",)
    assert {data[name].attrs["units"] for name in ("layer_left_lower", "wear_lower")} == {"mm"}
    for body in ("lower", "upper"):
        total = data[f"worn_volume_{body}_layers"].sum(axis=1)
        np.testing.assert_allclose(total, data[f"worn_volume_{body}"], rtol=1e-13)
    left = np.maximum(0.0035 - data["wear_lower"].values, 0.0)
    np.testing.assert_allclose(data["layer_left_lower"], left, atol=1e-15)
    area = 2.0 * np.pi * data["r"] * data["width"]
    share = ((left == 0.0) * area.values).sum(axis=1) / area.values.sum()
    np.testing.assert_allclose(data["share_through_lower"], share, rtol=1e-12)
    time = data.attrs["time_through_lower"]
    assert data["time"][np.argmax(share > 0) - 1] < time <= data["time"][np.argmax(share > 0)]
    assert np.isnan(data.attrs["time_through_upper"])


def test_the_mass_lost_is_that_of_each_layer(case, result):
    """What is not worn needs no density; where one is missing that is needed, there is no mass."""
    volumes = {b: result.layers[f"worn_volume_{b}_layers"][-1] for b in ("lower", "upper")}
    assert (volumes["lower"] > 0.0).all()  # through both layers
    assert volumes["upper"].tolist()[1:] == [0.0]
    masses = {"lower": volumes["lower"] @ [1.2, 2.7, 7.85], "upper": 4.0 * volumes["upper"][0]}
    film, below, itself = 1.2e-3, 2.7e-3, 7.85e-3  # g/mm3
    cases, missing = [], []
    for lower, upper, lacks in (
        ((film, below, itself), (4e-3, 3e-3), {}),
        ((film, below, itself), (4e-3, None), {}),
        ((film, None, itself), (4e-3, 3e-3), {"lower": "lower.layers[1]"}),
        ((film, below, None), (4e-3, 3e-3), {"lower": "lower.density"}),
        ((None, None, itself), (None, 3e-3),
         {"lower": "lower.layers[1]", "upper": "upper.layers[0].density not given"}),
    ):  # fmt: skip
        keys = {}
        for body, (*layers, own) in (("lower", lower), ("upper", upper)):
            keys |= {f"{body}.layers[{i}].density": density for i, density in enumerate(layers)}
            keys[f"{body}.density"] = own
        cases.append(case.replace(keys))
        missing.append(lacks)
    for one, lacks in zip(rw.simulate_all(cases, MPI.COMM_SELF), missing, strict=True):
        found = {n.name: n for n in key_numbers(one)}
        for body, mass in masses.items():
            number = found[f"{body}_mass"]
            assert lacks.get(body, "") in number.note
            expected = np.nan if body in lacks else mass
            assert number.value == pytest.approx(expected, rel=1e-6, nan_ok=True)


def test_a_worn_layer_of_another_modulus_is_a_doubt(result):
    assert not any("unworn layer" in doubt.text for doubt in result.doubts)
    hard = rw.simulate(rw.read_case(CASE, SMALL), MPI.COMM_SELF)
    (doubt,) = [one.text for one in hard.doubts if "unworn layer" in one.text]
    assert "lower.layers[0]" in doubt


def test_layers_in_tables_and_pictures(result, tmp_path):
    export(result, tmp_path / "history.csv")
    with (tmp_path / "history.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert (
        float(rows[-1]["worn_volume_lower_layers[2] (mm3)"])
        == (result.layers["worn_volume_lower_layers"][-1, 2])
    )
    assert float(rows[-1]["share_through_lower"]) == result.layers["share_through_lower"][-1]
    wear, through = plot(result, "wear,through").axes
    drawn = [line.get_ydata() for line in through.lines]
    np.testing.assert_allclose(drawn[0], 100.0 * result.layers["share_through_lower"])
    interface = [line for line in wear.lines if "end of layer" in line.get_label()]
    # um, both of lower, the coating of upper is far from worn
    np.testing.assert_allclose([line.get_ydata()[0] for line in interface], [0.5, 3.5])
    plain = rw.simulate(rw.read_case(CASE, {**SMALL, "lower.layers": None}), MPI.COMM_SELF)
    assert dict(plain.layers) == {}
    with pytest.raises(rw.InputError, match="layers"):
        plot(plain, "through")
