"""What notebooks show of outcomes: their numbers and one picture."""

from paths import CASES, PAPER, ROOT

import ringwear_par as rw


def test_outcomes_show_their_numbers_and_a_picture():
    keys = {"mesh.contact_elements": 8, "time.steps": 2}
    result = rw.simulate(rw.read_case(PAPER, keys))
    measured = rw.measure(ROOT / "scripts/measure/measure.toml")
    for outcome, words in ((result, ("penetration", "torque")), (measured, ("wear rate",))):
        html = outcome._repr_html_()
        assert html.count('<img src="data:image/png;base64,') == 1
        assert all(word in html for word in words)
    study = rw.read_study(CASES / "study.toml")._repr_html_()
    assert study.count("<svg") == 1
    assert "0, 20, 40" in study
