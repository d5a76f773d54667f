"""``ringwear verify``: ten checks, and what it says where one fails."""

import numpy as np
import pytest
from parts import main

import ringwear_par as rw
from ringwear_par import verify


def test_a_failed_check_is_named_and_ends_with_status_1(monkeypatch, capsys):
    """The nine others have passed."""
    monkeypatch.setattr(verify, "APPROACH", 1.001 * verify.APPROACH)
    assert main(["verify"]) == 1
    printed, said = capsys.readouterr()
    *rows, last = printed.splitlines()[1:]
    assert sorted(row.split()[-1] for row in rows) == ["failed", *["ok"] * 9]
    assert last.startswith("9 of 10 checks passed")
    assert "failed: paper's rings, finite elements: approach" in said


def test_what_is_no_number_has_failed_too(monkeypatch, comm, capsys):
    """And the checks after it are done; one rank prints."""

    def checks(comm):
        yield verify.Check("bar", np.array([1.0, np.nan]), 1.0, 1e-2)
        yield verify.Check("disc", np.array([2.0, 2.2]), np.array([2.0, 2.0]), 1e-2)
        yield verify.Check("cone", 3.001, 3.0, 1e-2)

    monkeypatch.setattr(verify, "CHECKS", (checks,))
    with pytest.raises(rw.ComputationError, match=r"1 of 3 .*bar; disc"):
        verify.verify(comm)
    rows = capsys.readouterr().out.splitlines()
    assert [row.split()[-1] for row in rows[1:-1]] == ["failed", "failed", "ok"]
    assert rows[2].split()[1:4] == ["2.2", "2", "1.0e-01"]  # the worst of its numbers
