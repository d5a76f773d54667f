"""The kinds of readings that fits take of tests: one table."""

from dataclasses import dataclass

from ringwear_par.elasticity.sections import BODIES


@dataclass(frozen=True)
class ReadingKind:
    """A kind of readings, as "penetration", or "profile" of the quantity "profile.lower"."""

    #: of the readings within the program
    unit: str
    #: kinds that these readings may have
    nuisances: tuple[str, ...]
    #: the variable of a history that is read in time, "worn_volume" of a body; None: it is read
    #: along the radius, or once
    variable: str | None
    #: whether its quantities name a body
    of_body: bool = False
    #: whether they are of what is worn off: of the body that the quantity names, or of both
    of_wear: bool = True


_OF_RIGS = ("offset", "drift", "compliance", "thermal")
READING_KINDS = {
    "penetration": ReadingKind("mm", _OF_RIGS, "penetration"),
    "approach": ReadingKind("mm", _OF_RIGS, "approach"),
    "torque": ReadingKind("N mm", ("offset", "drift"), "torque", of_wear=False),
    "profile": ReadingKind("mm", ("level", "tilt"), None, of_body=True),
    "mass": ReadingKind("g", ("offset",), "worn_volume", of_body=True),
    "volume": ReadingKind("mm^3", ("offset",), "worn_volume", of_body=True),
    "through": ReadingKind("s", (), None, of_body=True),
}
#: the quantities that a series may be of
QUANTITIES = tuple(
    quantity
    for name, kind in READING_KINDS.items()
    for quantity in ([f"{name}.{body}" for body in BODIES] if kind.of_body else [name])
)
