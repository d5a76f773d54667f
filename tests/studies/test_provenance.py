"""Versions and doubts of stored cases: never mixed in silence, never silent."""

import pytest
from swept import CASE, table, write_study

import ringwear_par
from ringwear_par import version
from ringwear_par.errors import InputError
from ringwear_par.studies.execution import plan, team_store
from ringwear_par.studies.execution.sweep import sweep
from ringwear_par.studies.storage.ensemble import open_ensemble

THRESHOLDS = '[vary]\n"wear.lower.p0" = {{ values = [{}] }}\n'


@pytest.fixture
def swept(tmp_path, comm):
    """Sweep some thresholds in one folder."""

    def swept(values, case=CASE, **how):
        path = write_study(tmp_path, comm, THRESHOLDS.format(values), case)
        return sweep(path, tmp_path / "out", comm, **how)

    return swept


def test_another_version_does_not_mix_with_the_first(swept, tmp_path, comm, monkeypatch):
    mine = ringwear_par.__version__
    swept("0, 20")
    for module in (ringwear_par, version, plan, team_store):
        monkeypatch.setattr(module, "__version__", "99.0")
    assert swept("0, 20").computed == 0  # nothing to mix
    with pytest.raises(InputError) as raised:
        swept("0, 20, 40")
    assert f"2 by {mine}" in str(raised.value)
    assert swept("40").computed == 1  # the others are no longer of the study
    versions = dict.fromkeys(["0", "20"], mine) | {"40": "99.0"}
    rows = table(tmp_path / "out")
    assert {row["wear.lower.p0"]: row["version"] for row in rows} == versions


UNSTABLE = CASE.replace('scheme = "implicit"', 'scheme = "explicit"').replace(
    "step = 1.0", "step = 40.0"
)


def test_doubts_are_flags_of_a_sweep(swept, tmp_path):
    """As test_blocks.py has them beside those of runs."""
    text = UNSTABLE.replace("omega = 3.541666666666667", "omega = 35.0")
    assert "unstable explicit step" in str(swept("0, 20, 79.9", text))
    assert "unstable explicit step" in str(swept("0, 20, 79.9", text))  # nothing computed
    rows = table(tmp_path / "out")
    assert "unstable_explicit_step" in rows[0]["flags"]
    with open_ensemble(tmp_path / "out") as data:
        assert [str(v) for v in data.flags.values] == [row["flags"] for row in rows]
