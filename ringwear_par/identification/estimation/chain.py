"""The walk of a posterior's walkers, kept on disk so that a stopped fit goes on with it."""

import logging
import time
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.files.ordinary import open_ordinary
from ringwear_par.files.writing import atomic_write

log = logging.getLogger(__name__)

#: between two times that a walk is kept
KEEP_SECONDS = 10.0


@dataclass(frozen=True, eq=False)
class Walk:
    """Walkers as far as they have gone.

    Parameters
    ----------
    steps : (s, w, m) where they were, the last one where they are.
    log_prob : (w,) there.
    accepted : of their moves so far.
    histories : computed for them so far.
    random_state : of NumPy's RandomState before the next step.
    """

    steps: FloatArray
    log_prob: FloatArray
    accepted: int
    histories: int
    random_state: tuple[Any, ...]


class Keeper:
    """Where a walk is kept until the fit is done; by one rank.

    Parameters
    ----------
    path : of the file; None: nothing is kept.
    key : of the problem; what another problem has left is not used.
    """

    def __init__(self, path: Path | None, key: str) -> None:
        self._path, self._key = path, key
        self._kept = time.perf_counter()

    def read(self) -> Walk | None:
        """Return the walk that is kept; None if there is none."""
        if self._path is None:
            return None
        try:
            with open_ordinary(self._path) as opened, np.load(opened) as file:
                if str(file["key"]) != self._key:
                    return None
                place, gauss = file["place"].tolist(), float(file["gauss"])
                state = ("MT19937", file["random"], *place, gauss)
                np.random.RandomState().set_state(state)  # one that it takes
                counts = int(file["accepted"]), int(file["histories"])
                return Walk(file["steps"], file["log_prob"], *counts, state)
        except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile):
            return None

    @property
    def due(self) -> bool:
        """Whether it is time to keep the walk again."""
        return self._path is not None and time.perf_counter() - self._kept > KEEP_SECONDS

    def write(self, walk: Walk) -> None:
        """Keep a walk; a full disk only costs the restart."""
        if self._path is None:
            return
        _, random, place, has_gauss, gauss = walk.random_state
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(self._path) as temporary, temporary.open("wb") as file:
                np.savez(
                    file, key=self._key, steps=walk.steps, log_prob=walk.log_prob,
                    accepted=walk.accepted, histories=walk.histories, random=random,
                    place=[place, has_gauss], gauss=gauss,
                )  # fmt: skip
        except OSError as error:
            log.warning("%s: cannot be written: %s", self._path, error.strerror or error)
        self._kept = time.perf_counter()
