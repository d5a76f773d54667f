"""What is to be measured, complete and consistent, as frozen dataclasses."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.weighings import Weighing
from ringwear_par.measuring.definition.records import Record
from ringwear_par.schedules import Quantity, mean, mean_of_product, smallest

Body = Literal["lower", "upper"]


@dataclass(frozen=True)
class Uncertainty:
    """A standard uncertainty: a number, or a share of the value where it is ``relative``."""

    size: float
    relative: bool = False

    def of(self, value: float) -> float:
        """Return the standard uncertainty of a value."""
        return abs(self.size * value) if self.relative else self.size


@dataclass(frozen=True)
class Conditions:
    """What a test is run at: means over a part of it."""

    #: N
    force: float
    #: rad/s
    omega: float
    #: N rad/s, mean of force times omega, which is not that of their means where both change
    product: float
    #: mm, radii of the contact
    inner: float
    outer: float

    @property
    def area(self) -> float:
        """Nominal contact area, mm2."""
        return math.pi * (self.outer**2 - self.inner**2)

    @property
    def pressure(self) -> float:
        """Mean pressure, MPa."""
        return self.force / self.area

    @property
    def radius(self) -> float:
        """Mean radius of friction, mm: 2/3 (b^3 - a^3) / (b^2 - a^2)."""
        cubes, squares = (self.outer**n - self.inner**n for n in (3, 2))
        return 2.0 / 3.0 * cubes / squares

    @property
    def speed(self) -> float:
        """Sliding speed at the mean radius, mm/s."""
        return self.omega * self.radius

    @property
    def pv(self) -> float:
        """Mean of pressure times speed, MPa m/s."""
        return self.product / self.area * self.radius * 1e-3


@dataclass(frozen=True, eq=False)
class Test:
    """A test: its record, its weighing, and the case of its rig."""

    #: pytest looks for classes that are called so
    __test__ = False

    name: str
    case: Case
    record: Record
    #: s, of sliding
    duration: float
    #: None where there is none
    weighing: Weighing | None

    def __repr__(self) -> str:
        return f"<Test {self.name}: {self.record!r}>"

    @property
    def body(self) -> Body:
        """The body that wears."""
        return "upper" if self.case.wear_lower is None and self.case.wear_upper else "lower"

    @property
    def density(self) -> float | None:
        """Density of the body that wears, g/mm3."""
        return self.case.upper.density if self.body == "upper" else self.case.lower.density

    @property
    def force(self) -> Quantity:
        """The load, N."""
        if self.case.load.force is None:
            raise ValueError("a displacement is no load")
        return self.case.load.force

    @property
    def slides(self) -> bool:
        """Whether it is always loaded, and turned."""
        return smallest(self.force) > 0.0 and mean(self.case.load.omega, 0.0, self.duration) > 0.0

    def conditions(self, start: float, end: float) -> Conditions:
        """Return the conditions of a part of the test, between two times (s)."""
        quantities = self.force, self.case.load.omega
        force, omega = (mean(quantity, start, end) for quantity in quantities)
        product = mean_of_product(*quantities, start, end)
        return Conditions(force, omega, product, *self.case.overlap)


@dataclass(frozen=True)
class Limits:
    """When a test is steady."""

    #: shares of the rate and of the coefficient that they may change by
    wear: float = 0.15
    friction: float = 0.05
    #: s, where the steady part begins; None: it is looked for
    start: float | None = None


@dataclass(frozen=True, eq=False)
class Problem:
    """What a measure file asks."""

    #: what messages call it
    name: str
    #: TOML
    text: str
    tests: tuple[Test, ...]
    #: g, of one weighing; None: not known
    mass_sd: float | None
    #: "A" where readings tell it
    mass_type: Literal["A", "B"]
    #: by case key, or "torque", "displacement", "time"
    uncertainty: Mapping[str, Uncertainty]
    limits: Limits = field(default_factory=Limits)
    #: SHA-256 of the files, by name
    hashes: Mapping[str, str] = field(default_factory=dict)
    #: sentences about what was read
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<Problem {self.name}: {', '.join(test.name for test in self.tests)}>"
