"""``ringwear verify``: ten checks, and what it says where one fails."""

import numpy as np
import pytest
from commands import python, ringwear

import ringwear_par as rw
from ringwear_par import verify


def test_the_command():
    result = ringwear("verify")
    assert result.returncode == 0, result.stderr
    *rows, last = result.stdout.splitlines()[1:]
    assert [row.split()[-1] for row in rows] == ["ok"] * 10
    assert last.startswith("10 of 10 checks passed")


def test_a_failed_check_is_named_and_ends_with_status_1():
    program = """
from ringwear_par import cli, verify
verify.APPROACH *= 1.001
raise SystemExit(cli.main(["verify"]))
"""
    result = python("-c", program)
    assert result.returncode == 1
    assert result.stdout.splitlines()[-1].startswith("9 of 10 checks passed")
    assert "failed: paper's rings, finite elements: approach" in result.stderr


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
