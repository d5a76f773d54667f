"""Cases and fit files of standard tests: dimensions, and their wear in closed form."""

import math

import pytest
from paths import ROOT

import ringwear_par as rw
from ringwear_par.cli import main

PSI_FEET_PER_MINUTE = 6894.757e-6 * 5.08  # MPa mm/s
#: area mm^2, p V MPa mm/s, specific wear rate mm^3/(N mm)
NUMBERS = {
    "astm_d3702": (129.0, 2500.0 * PSI_FEET_PER_MINUTE, 8e-10),
    "jis_k7218_a": (200.0, 0.25 * 500.0, 1e-8),
    "face_seal": (math.pi * (27.0**2 - 24.0**2), 0.2 * 50.0 * math.pi * 25.5, 2e-11),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_standard_case(name):
    case = rw.read_case(ROOT / f"scripts/cases/{name}.toml")
    area, pv, rate = NUMBERS[name]
    assert case.area == pytest.approx(area, rel=5e-3)
    # a worn-in face is level but for some rate/k/E, so that its mean depth is its penetration
    history = rw.simulate(case).histories
    depth = rate * pv * case.time.end
    assert history["worn_volume_upper"][-1] / case.area == pytest.approx(depth, rel=5e-3)
    assert history["penetration"][-1] == pytest.approx(depth, rel=1e-2)


@pytest.mark.parametrize("name", NUMBERS)
def test_planned_fit_of_a_standard_test(name, tmp_path, capsys):
    fit = str(ROOT / f"scripts/fit/{name}.toml")
    assert main(["fit", fit, "-o", str(tmp_path / "out"), "--dry-run"]) in (0, None)
    assert "wear.upper.k" in capsys.readouterr().out
