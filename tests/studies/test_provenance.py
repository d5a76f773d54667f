"""Versions and doubts of stored cases: never mixed in silence, never silent."""

import pytest
from swept import CASE, table, variables, write_study

import ringwear_par
from ringwear_par import version
from ringwear_par.errors import InputError
from ringwear_par.studies.execution import plan, team_store
from ringwear_par.studies.execution.sweep import sweep
from ringwear_par.studies.storage.ensemble import open_ensemble

pytestmark = pytest.mark.serial

THRESHOLDS = '[vary]\n"wear.lower.p0" = {{ values = [{}] }}\n'


@pytest.fixture
def swept(shared_path, comm):
    """Sweep some thresholds in one folder."""

    def swept(values, case=CASE, **how):
        path = write_study(shared_path, comm, THRESHOLDS.format(values), case)
        try:
            return sweep(path, shared_path / "out", comm, **how)
        finally:
            comm.Barrier()

    return swept


@pytest.mark.ranks
def test_another_version_does_not_mix_with_the_first(swept, shared_path, comm, monkeypatch):
    mine = ringwear_par.__version__
    swept("0, 20")
    for module in (ringwear_par, version, plan, team_store):
        monkeypatch.setattr(module, "__version__", "99.0")
    assert swept("0, 20").computed == 0  # nothing to mix
    with pytest.raises(InputError) as raised:
        swept("0, 20, 40")
    (told,) = raised.value.faults
    for word in (f"2 by {mine}", "this is 99.0", "must be a new folder"):
        assert word in told
    with pytest.raises(InputError, match="2 by"):
        swept("0, 20, 40, 60", part=(2, 2))
    assert swept("40").computed == 1  # the others are no longer of the study
    versions = dict.fromkeys(["0", "20"], mine) | {"40": "99.0"}
    rows = table(shared_path / "out")
    assert {row["wear.lower.p0"]: row["version"] for row in rows} == versions
    assert sorted(v.decode() for v in variables(shared_path / "out")["version"]) == sorted(
        versions.values()
    )


UNSTABLE = CASE.replace('scheme = "implicit"', 'scheme = "explicit"').replace(
    "step = 1.0", "step = 40.0"
)


def test_doubts_are_flags_of_a_sweep(swept, shared_path):
    """As test_blocks.py has them beside those of runs; a slice counts its own."""
    text = UNSTABLE.replace("omega = 3.541666666666667", "omega = 35.0")
    assert text.count("explicit") == 1
    summary = swept("0, 20, 79.9", text, part=(1, 1))
    assert "unstable explicit step" in str(summary)
    assert not (shared_path / "out" / "results.h5").exists()
    summary = swept("0, 20, 79.9", text)
    rows = table(shared_path / "out")
    flags = [row["flags"].split(", ") for row in rows]
    assert "unstable_explicit_step" in flags[0]
    count = sum(row["flags"] != "" for row in rows)
    unstable = sum("unstable_explicit_step" in flag for flag in flags)
    assert summary.computed == 0
    assert f"{count} case" in str(summary)
    assert f"unstable explicit step ({unstable})" in str(summary)
    with open_ensemble(shared_path / "out") as data:
        assert [str(v) for v in data.flags.values] == [row["flags"] for row in rows]


def test_unlike_slopes_are_a_flag(swept, shared_path):
    """Of a cone over a flat face."""
    cone = "z = [20.0, 40.0]\nprofile = [[28.5, 20.0], [31.5, 20.9]]"
    text = CASE.replace("z = [20.0, 40.0]", cone).replace("steps = 20", "steps = 2")
    assert text.count("profile") == 1
    assert "unlike slopes" in str(swept("0, 20", text))
    assert all("unlike_slopes" in row["flags"] for row in table(shared_path / "out"))


def test_good_cases_have_no_flags(swept, shared_path):
    case = CASE.replace("contact_elements = 16", "contact_elements = 64")
    assert "flagged" not in str(swept("0, 20", case))
    assert {row["flags"] for row in table(shared_path / "out")} == {""}
