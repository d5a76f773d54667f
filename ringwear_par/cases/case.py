"""A case: one wear test, complete and consistent, as frozen dataclasses."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from typing import Any, Literal

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.faces import CLOSE
from ringwear_par.cases.law import NO_WEAR, Law
from ringwear_par.cases.schema import FIELDS, SCHEMES
from ringwear_par.elasticity.mesh import ContactLine, Mesh, contact_line
from ringwear_par.elasticity.sections import BODIES, Grip, Polyline, Section
from ringwear_par.errors import InputError
from ringwear_par.schedules import Quantity, bends, in_time
from ringwear_par.wear.user import WearLaw

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


#: dotted keys and values, or "KEY=VALUE" texts
Overrides = Mapping[str, Any] | Sequence[str]
#: times closer than this share of them are the same
SAME_TIME = 1e-12
#: first line of a stored text that is not the whole truth
CHANGED = "# changed in Python after it was read: not all of this is as run"


@dataclass(frozen=True)
class RingLayer:
    """A bonded layer of a ring: thickness in mm, Young's modulus in MPa, density in g/mm^3.

    ``wear`` is its wear law, None where it wears as the ring itself does.
    """

    thickness: float
    young: float
    poisson: float
    wear: WearLaw | None = None
    density: float | None = None


@dataclass(frozen=True)
class Ring:
    """A ring or disc: radii and heights in mm, Young's modulus in MPa, density in g/mm^3.

    ``face`` is the contact face in the body's own frame (see geometry), none the flat one;
    ``layers`` follow each other from the contact plane inwards.
    """

    r: tuple[float, float]
    z: tuple[float, float]
    young: float
    poisson: float
    grip: Grip
    face: Polyline = ()
    density: float | None = None
    layers: tuple[RingLayer, ...] = ()

    @property
    def densities(self) -> tuple[float | None, ...]:
        """Densities of the layers, from the contact face inwards, and of the ring itself."""
        return (*(layer.density for layer in self.layers), self.density)


def density_keys(body: str, layers: int) -> list[str]:
    """Return the keys of the ``Ring.densities`` of lower or upper with so many layers."""
    return [*(f"{body}.layers[{i}].density" for i in range(layers)), f"{body}.density"]


@dataclass(frozen=True)
class Load:
    """What presses and turns the upper ring, numbers or tables in time.

    ``force`` (N) or ``displacement`` (mm, downward) is given, the other is None; ``omega`` in
    rad/s.
    """

    omega: Quantity
    force: Quantity | None = None
    displacement: Quantity | None = None


@dataclass(frozen=True)
class Stepping:
    """Time steps: ``steps`` of length ``step`` (s), or adaptive ones until ``until`` (s).

    ``tolerance`` (mm) is the largest error of wear of a history by adaptive steps.
    """

    scheme: str
    step: float = 0.0
    steps: int = 0
    until: float = 0.0
    tolerance: float = 1e-5

    @property
    def adaptive(self) -> bool:
        """Whether steps are chosen by the tolerances."""
        return SCHEMES[self.scheme].adaptive

    @property
    def end(self) -> float:
        """Time at the end, s."""
        return self.until if self.adaptive else self.step * self.steps


@dataclass(frozen=True)
class Output:
    """What is stored: every so many steps, or at some times, and which fields of the contact line.

    ``profiles`` says whether the fields are stored as often as all else, or at the last step only;
    ``boundary`` at which of them whole-boundary fields are stored, or from which times on the next.
    """

    every: int = 1
    fields: tuple[str, ...] = FIELDS
    profiles: Literal["all", "last"] = "all"
    times: tuple[float, ...] = ()
    boundary: str | tuple[float, ...] = "none"


@dataclass(frozen=True)
class Case:
    """One wear test, complete and consistent.

    Parameters
    ----------
    stress : what stresses are stored; None: none.
    stop : limits, in the units of ``STOP_CRITERIA``, that end the history before its time, by name.
    text : the TOML text as run, overrides included; "" for a case that was constructed.
    with_units : keys whose numbers were written with a unit.
    rebuild : makes a changed case of the text; None where the text does not tell this case, for it
        was constructed or changed as a dataclass.
    """

    lower: Ring
    upper: Ring
    friction: Quantity
    wear_lower: WearLaw | None
    wear_upper: WearLaw | None
    load: Load
    time: Stepping
    mesh: Mesh
    output: Output
    stress: Stress | None = None
    stop: tuple[tuple[str, float], ...] = ()
    title: str = ""
    text: str = field(default="", compare=False, repr=False)
    with_units: frozenset[str] = field(default=frozenset(), compare=False, repr=False)
    rebuild: Callable[[str, Overrides], "Case"] | None = field(
        default=None, init=False, compare=False, repr=False
    )

    def __repr__(self) -> str:
        rings = ", ".join(
            f"{body} r = {ring.r[0]:g} to {ring.r[1]:g} mm"
            for body, ring in zip(BODIES, self.rings, strict=True)
        )
        wear = ", ".join(f"{table} by {law}" for table, law in self.laws_by_table.items() if law)
        return (
            f"<Case{f' {self.title!r}' if self.title else ''}: {rings}; {wear or 'nothing wears'}; "
            f"{self.mesh.contact_elements} contact elements, {self.time.end:g} s>"
        )

    def _repr_html_(self) -> str:
        """Return the drawing of the rig, for notebooks."""
        # pictures stand on cases, which know nothing else of them
        return str(import_module("ringwear_par.pictures.rig").rig_html(self))

    @property
    def overlap(self) -> tuple[float, float]:
        """Radii between which the bodies face each other, mm."""
        return max(self.lower.r[0], self.upper.r[0]), min(self.lower.r[1], self.upper.r[1])

    @property
    def contact(self) -> tuple[float, float]:
        """Inner and outer radius of the contact line, mm: the overlap, cut to mesh.contact."""
        a, b = self.overlap
        if self.mesh.contact is None:
            return a, b
        low, high = self.mesh.contact
        # an end that means the overlap's is the overlap's
        return (
            a if low - a <= CLOSE * b else low,
            b if b - high <= CLOSE * b else high,
        )

    @property
    def open_ends(self) -> tuple[bool, bool]:
        """Whether mesh.contact cut the inner and the outer end: contact must not reach there."""
        (a, b), (inner, outer) = self.contact, self.overlap
        return a > inner, b < outer

    @cached_property
    def line(self) -> ContactLine:
        """The contact elements of the pair."""
        return contact_line(self.contact, self.mesh, *self.sections)

    @cached_property
    def smallest_gaps(self) -> tuple[float, float]:
        """Smallest gaps (mm) of the undeformed faces in the contact and where mesh.contact cut."""
        (a, b), (inner, outer) = self.contact, self.overlap
        corners = [r for section in self.sections for r, _ in section.points]
        r = np.unique(np.clip([*corners, a, b, inner, outer], inner, outer))
        gap, inside = self.gap_at(r), (r >= a) & (r <= b)
        return float(gap[inside].min()), float(gap[~inside].min(initial=math.inf))

    def gap_at(self, r: FloatArray) -> FloatArray:
        """Return the gap (mm) of the undeformed, unworn faces at radii; negative: overlapping."""
        lower, upper = (section.depth(r) for section in self.sections)
        return (self.upper.z[0] - self.lower.z[1]) - lower - upper

    @cached_property
    def initial_gap(self) -> FloatArray:
        """(n,) mm, gap of the unworn faces at the mid-points of the contact elements."""
        return self.gap_at(self.line.r)

    @property
    def interpenetration(self) -> float:
        """Largest overlap (mm) of the undeformed bodies along the contact line, 0 for none."""
        a, b = self.contact
        r = np.concatenate([[a, b], *(section.points[:, 0] for section in self.sections)])
        deepest = -float(self.gap_at(r[(r >= a) & (r <= b)]).min())
        size = max(1.0, *map(abs, self.lower.z + self.upper.z))
        return deepest if deepest > CLOSE * size else 0.0

    @property
    def rings(self) -> tuple[Ring, Ring]:
        """Lower and upper."""
        return self.lower, self.upper

    @property
    def materials(self) -> dict[str, Ring | RingLayer]:
        """Each body and its layers by table of keys: "lower", "lower.layers[0]"."""
        materials: dict[str, Ring | RingLayer] = {}
        for body, ring in zip(BODIES, self.rings, strict=True):
            materials[body] = ring
            materials |= {f"{body}.layers[{i}]": layer for i, layer in enumerate(ring.layers)}
        return materials

    @property
    def laws_by_table(self) -> dict[str, Law]:
        """Wear laws of bodies, and of layers that do not wear as their body, by table of keys."""
        laws: dict[str, Any] = {}
        body_laws = self.wear_lower, self.wear_upper
        for body, ring, law in zip(BODIES, self.rings, body_laws, strict=True):
            laws[f"wear.{body}"] = law
            laws |= {f"{body}.layers[{i}].wear": layer.wear for i, layer in enumerate(ring.layers)}
        return {table: Law.of(law) for table, law in laws.items() if law is not None}

    @cached_property
    def laws(self) -> tuple[tuple[Law, ...], tuple[Law, ...]]:
        """Wear laws of lower and upper: of layers, inwards, and of the body; () if none wears."""
        return _laws(self.lower, self.wear_lower), _laws(self.upper, self.wear_upper)

    def layer_ends(self, body: int) -> FloatArray:
        """Return the depths at which layers of lower (0) or upper (1) end, (layers, n) mm.

        From the unworn face, along the axis; layers count from the contact plane.
        """
        ring = self.rings[body]
        ends = np.cumsum([layer.thickness for layer in ring.layers])[:, None]
        return ends + self.section(ring).depth(self.line.r)

    @property
    def area(self) -> float:
        """Nominal contact area, mm^2: of the overlap, whatever the faces."""
        a, b = self.overlap
        return math.pi * (b * b - a * a)

    @property
    def mean_radius(self) -> float:
        """Middle of the overlap, mm."""
        return 0.5 * sum(self.overlap)

    @property
    def follows_wear(self) -> bool:
        """Whether elements follow the worn profile."""
        return self.mesh.geometry == "updated" and any(self.laws)

    @cached_property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which a schedule or a parameter bends, s: adaptive steps end there."""
        load = self.load
        inside: set[float] = set()
        for schedule in (load.omega, load.force, load.displacement, self.friction):
            inside.update(bends(schedule))
        for of_body in self.laws:
            for law in of_body:
                inside.update(law.breakpoints)
        times: list[float] = []
        for time in sorted(t for t in inside if t < self.time.end):
            if not times or time - times[-1] > SAME_TIME * time:
                times.append(time)
        return tuple(times)

    def friction_at(self, time: float) -> float:
        """Return the friction coefficient at a time, s."""
        return in_time(self.friction, time)

    @property
    def about_steps(self) -> float:
        """About how many steps it takes, an adaptive one counting as several fixed ones."""
        return (
            100.0 + 20.0 * len(self.breakpoints) if self.time.adaptive else float(self.time.steps)
        )

    @property
    def stored_rows(self) -> float:
        """About how many states are stored."""
        if self.output.times:
            return 2.0 + len(self.output.times)
        return (100.0 if self.time.adaptive else 1.0 + self.time.steps) / self.output.every

    @property
    def last_stored_time(self) -> float:
        """The last time at which a key says that something is stored, s; 0 where none does."""
        times = [self.output.times, self.output.boundary, self.stress and self.stress.times]
        return max((part[-1] for part in times if isinstance(part, tuple) and part), default=0.0)

    def section(self, ring: Ring) -> Section:
        """Return the meridian section of one of the two rings, in its own frame."""
        layers = tuple(layer.thickness for layer in ring.layers)
        return Section(ring.r, ring.z[1] - ring.z[0], ring.face, layers)

    @property
    def sections(self) -> tuple[Section, Section]:
        """Meridian sections of lower and upper, each in its own frame."""
        return self.section(self.lower), self.section(self.upper)

    def replace(self, changes: Overrides) -> "Case":
        """Return a copy with some keys changed, checked like any case. Not collective.

        Parameters
        ----------
        changes : as the overrides of ``read_case``.

        Raises
        ------
        InputError : all faults, one sentence each; or this case has no text that tells its keys.
        """
        if self.rebuild is None:
            raise InputError(
                "case: its text does not tell its keys, for it was constructed or changed as a "
                "dataclass; replace needs a case that read_case or replace returned"
            )
        return self.rebuild(self.text, changes)

    @property
    def stored_text(self) -> str:
        """The text to be stored: one that is not the whole truth says so."""
        if self.rebuild is not None:
            return self.text
        return f"{CHANGED}\n{self.text}"


def _laws(ring: Ring, body_law: WearLaw | None) -> tuple[Law, ...]:
    """Return the laws of a ring's layers, which by default wear as the ring, and of itself."""
    own = [*(layer.wear for layer in ring.layers), body_law]
    laws = [body_law if law is None else law for law in own]
    if all(law is None for law in laws):
        return ()
    return tuple(NO_WEAR if law is None else Law.of(law) for law in laws)


def refuse_stop(case: Case, name: str, purpose: str) -> None:
    """Refuse a case that may end before its time, for a purpose that needs all of it.

    Raises
    ------
    InputError : it has limits that end it.
    """
    if case.stop:
        raise InputError(
            *(
                f"{name}: stop.{key} = {limit:g}: must be absent {purpose}, which needs whole "
                "histories"
                for key, limit in case.stop
            )
        )


def need_case(value: object, name: str) -> None:
    """Refuse what is no Case, and say what makes one; ``name`` is of the function that needs it.

    Raises
    ------
    InputError : it is none.
    """
    if not isinstance(value, Case):
        raise InputError(
            f"{name}: a Case is needed, not {type(value).__name__}; read_case reads a file or a "
            "dict"
        )
