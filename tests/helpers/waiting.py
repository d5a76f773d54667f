"""A study whose cases wait under way while a test wants them to, instead of taking long."""

from paths import PAPER

_LAW = '''"""The threshold law; where k is the larger, after 4 s it waits by a file hold.

So many seconds as it says, each time that it is asked. What waits leaves a file of its process.
"""

import os
import time
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).parent


def asked():
    try:
        return float((FOLDER / "hold").read_text())
    except FileNotFoundError:
        return 0.0


def rate(p, at):
    k, p0 = at.parameters["k"], at.parameters["p0"]
    if k > 5e-7 and np.max(at.time) > 4.5:
        started, seconds = time.monotonic(), asked()
        if seconds:
            (FOLDER / f"waits_{os.uname().nodename}_{os.getpid()}").touch()
        while time.monotonic() - started < asked():
            time.sleep(0.005)
    return k * at.friction * at.speed * np.maximum(p - p0, 0.0)


def d_rate_dp(p, at):
    k, p0 = at.parameters["k"], at.parameters["p0"]
    return k * at.friction * at.speed * (p > p0)
'''
_STUDY = """case = "waiting.toml"
[vary]
"wear.lower.parameters.k" = {{ values = [1e-7, 1e-6] }}
"wear.lower.parameters.p0" = {{ values = {thresholds} }}
[design]
method = "grid"
"""
_PAPER = PAPER


#: of each case, of 1 s
STEPS = 40


class Waiting:
    """The files of a study, and of its base case, which waits once it is under way.

    So do half of the study's cases, the latter.

    Parameters
    ----------
    folder : to write them to.
    thresholds : of the law: a case with either k each.
    """

    def __init__(self, folder, thresholds=(0, 20, 40, 60, 70)):
        self.folder, self.study, self.case = folder, folder / "study.toml", folder / "waiting.toml"
        self.cases = 2 * len(thresholds)
        text = _PAPER.read_text(encoding="utf-8").replace("steps = 200", f"steps = {STEPS}")
        law = 'law = "user"\nfile = "waiting.py"\nparameters = { k = 1e-6, p0 = 40.0 }'
        before, rest = text.split("[wear.lower]")
        after = rest[rest.index("\n[") :]
        text = f"{before}[wear.lower]\n{law}\n{after}\n[mesh]\ncontact_elements = 16\n"
        self.case.write_text(text, encoding="utf-8")
        (folder / "waiting.py").write_text(_LAW, encoding="utf-8")
        self.study.write_text(_STUDY.format(thresholds=list(thresholds)), encoding="utf-8")

    def hold(self, seconds=0.2):
        """Have cases wait so long about four times a step from now on."""
        for path in self.folder.glob("waits_*"):
            path.unlink()
        (self.folder / "new").write_text(str(seconds))
        (self.folder / "new").replace(self.folder / "hold")

    def release(self):
        """Let them go on."""
        (self.folder / "hold").unlink(missing_ok=True)

    @property
    def waits(self):
        """How many processes have waited since they were told to."""
        return len(list(self.folder.glob("waits_*")))
