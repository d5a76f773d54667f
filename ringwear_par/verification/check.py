"""One comparison of a computed solution with an exact one."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

#: what a computed solution is compared with. "reference": a solution that is known exactly, or
#: converged (finite elements; a mesh or steps far finer than those checked). "identity": a balance
#: or symmetry, which holds to round-off (on held faces: vanishes with the mesh). "bound": a number,
#: as of steps, that must not exceed another
Kind = Literal["reference", "identity", "bound"]
#: numbers of elements at which errors are computed, to see their order
SIZES = (32, 64, 128)
#: Poisson's ratio of all checks
NU = 0.3


@dataclass(frozen=True)
class Check:
    """One row: relative (or stated) errors at one or more sizes, the last to meet the tolerance."""

    #: what is compared with what
    name: str
    #: numbers of contact elements
    sizes: tuple[int, ...]
    #: one for each size
    errors: tuple[float, ...]
    #: largest error allowed at the last size
    tolerance: float
    #: relative accuracy of the reference itself; errors near it show no order
    digits: float = 1e-7
    #: what it is compared with
    kind: Kind = "reference"

    @property
    def passed(self) -> bool:
        """Whether the last error is small enough (not so for NaN)."""
        return self.errors[-1] <= self.tolerance

    @property
    def order(self) -> float | None:
        """Observed order over the last two sizes whose errors exceed the reference's own."""
        clear = [
            (n, e) for n, e in zip(self.sizes, self.errors, strict=True) if e > 3 * self.digits
        ]
        if len(clear) < 2:
            return None
        (n1, e1), (n2, e2) = clear[-2:]
        return math.log(e1 / e2) / math.log(n2 / n1)


def checks_of(
    errors: Sequence[Sequence[float]],
    rows: Iterable[tuple[str, float] | tuple[str, float, float]],
    sizes: tuple[int, ...] = SIZES,
    kind: Kind = "reference",
) -> Iterator[Check]:
    """Return the checks of errors of each size, whatever their signs, that go together, one a row.

    A row is a name, a tolerance and, where it is not the default of ``Check``, the reference's
    accuracy.
    """
    for values, row in zip(zip(*errors, strict=True), rows, strict=True):
        name, tolerance = row[:2]
        digits = row[2] if len(row) == 3 else Check.digits
        yield Check(name, sizes, tuple(map(abs, values)), tolerance, digits, kind)


def converging(name: str, error: Callable[[int], float], tolerance: float) -> Check:
    """Return the check of an error that is a function of the number of elements."""
    return Check(name, SIZES, tuple(error(n) for n in SIZES), tolerance)


def identity(name: str, n: int, error: float, tolerance: float) -> Check:
    """Return the check of a balance or symmetry on n elements."""
    return Check(name, (n,), (error,), tolerance, kind="identity")


def bound(name: str, n: int, value: float, most: float) -> Check:
    """Return the check that a number, found on n elements, does not exceed another."""
    return Check(name, (n,), (value,), most, kind="bound")
