"""Where and when a case asks for stress: points and a grid, each in one of the bodies."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ringwear_par.arrays import FloatArray

#: of which material a point on the line between two is
Side = Literal["", "above", "below"]


@dataclass(frozen=True)
class Grid:
    """Points at ``n`` radii and heights between two each (mm), of one body or of both."""

    body: Literal["lower", "upper", "both"]
    r: tuple[float, float]
    z: tuple[float, float]
    n: tuple[int, int]

    @property
    def axes(self) -> tuple[FloatArray, FloatArray]:
        """Radii and heights, mm."""
        return np.linspace(*self.r, self.n[0]), np.linspace(*self.z, self.n[1])


@dataclass(frozen=True)
class Stress:
    """What stresses are stored."""

    #: r and z (mm) in the frame of the case, and the side of a face or an interface that they lie
    #: on; inside a body any side is as good as none
    points: tuple[tuple[float, float, Side], ...] = ()
    #: further ones, of which those outside the bodies have none
    grid: Grid | None = None
    #: of the stored states, which; or times (s) from each of which on the first one is
    times: str | tuple[float, ...] = "last"
    #: mm, radius round edges in which the largest stress is not looked for
    exclude: float = 0.1

    @property
    def size(self) -> float:
        """Number of points, those of the grid included."""
        return len(self.points) + (float(self.grid.n[0]) * self.grid.n[1] if self.grid else 0.0)
