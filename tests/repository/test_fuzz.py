"""The first inputs of scripts/fuzz.py: none ends in a traceback, hangs or leaves a file."""

import re
import subprocess
import sys

import pytest
from commands import SHELL_ENVIRONMENT
from paths import ROOT

FUZZ = ROOT / "scripts" / "fuzz.py"


@pytest.mark.serial
@pytest.mark.slow
def test_damaged_and_malicious_input_is_refused_in_a_sentence():
    command = [sys.executable, str(FUZZ), "--count", "42", "--seed", "5"]
    done = subprocess.run(command, env=SHELL_ENVIRONMENT, capture_output=True, text=True,
                          timeout=500, check=False)  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(
        r"42 inputs .* traceback 0, hang 0, crash 0, no sentence 0, written 0", done.stdout
    )
    for kind in ("case", "study", "table", "result", "ensemble", "words"):
        (told,) = re.findall(f"^{kind}: (.*)$", done.stdout, re.MULTILINE)
        assert int(re.search(r"(\d+) refused", told)[1]) >= 3  # else it would show nothing
