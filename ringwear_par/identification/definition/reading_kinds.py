"""The kinds of readings that fits take of tests: one table, and what readings are taken from."""

from collections.abc import Callable
from dataclasses import dataclass

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.sections import BODIES


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The quantities of a history that are read, at its s steps, the start included."""

    #: (s,) s.
    time: FloatArray
    #: (s,) mm.
    approach: FloatArray
    #: (s,) N mm.
    torque: FloatArray
    #: (2, s) mm^3, worn off lower and upper.
    volume: FloatArray
    #: (2, s, n) mm.
    wear: FloatArray
    #: (2, s) g, lost by lower and upper by the densities of their layers; NaN where these are
    #: not known.
    mass: FloatArray
    #: (2,) s, at which the first layers of lower and upper are worn through; NaN without layers
    through: FloatArray


@dataclass(frozen=True)
class ReadingKind:
    """A kind of readings, as "penetration", or "profile" of the quantity "profile.lower"."""

    #: of the readings within the program
    unit: str
    #: kinds that these readings may have
    nuisances: tuple[str, ...]
    #: returns what is read at the ends of steps, (s,), of a body (0 lower, 1 upper) and its
    #: density, g/mm^3; None: ``readings.py`` reads it in another way
    values: Callable[[Trajectory, int, float | None], FloatArray] | None
    #: whether its quantities name a body
    of_body: bool = False
    #: whether they are of what is worn off: of the body that the quantity names, or of both
    of_wear: bool = True


def _mass(trajectory: Trajectory, body: int, density: float | None) -> FloatArray:
    return trajectory.mass[body] if density is None else density * trajectory.volume[body]


_OF_RIGS = ("offset", "drift", "compliance", "thermal")
READING_KINDS = {
    "penetration": ReadingKind("mm", _OF_RIGS, lambda t, *_: t.approach - t.approach[0]),
    "approach": ReadingKind("mm", _OF_RIGS, lambda t, *_: t.approach),
    "torque": ReadingKind("N mm", ("offset", "drift"), lambda t, *_: t.torque, of_wear=False),
    "profile": ReadingKind("mm", ("level", "tilt"), None, of_body=True),
    "mass": ReadingKind("g", ("offset",), _mass, of_body=True),
    "volume": ReadingKind("mm^3", ("offset",), lambda t, body, _: t.volume[body], of_body=True),
    "through": ReadingKind("s", (), None, of_body=True),
}
#: the quantities that a series may be of
QUANTITIES = tuple(
    quantity
    for name, kind in READING_KINDS.items()
    for quantity in ([f"{name}.{body}" for body in BODIES] if kind.of_body else [name])
)
