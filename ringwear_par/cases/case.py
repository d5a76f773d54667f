"""Case files: TOML tables read into frozen dataclasses, every fault reported at once."""

import difflib
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.laws import law_faults, law_keys, make_law
from ringwear_par.cases.schema import BY_PATH, FIELDS, KEYS, TABLES, RejectedError, toml_value
from ringwear_par.elasticity.mesh import ContactLine, Mesh, contact_line, contact_pieces
from ringwear_par.elasticity.profiles import (
    CLOSE,
    chamfer_face,
    chamfer_faults,
    profile_face,
    profile_faults,
)
from ringwear_par.elasticity.sections import Grip, Polyline, Section
from ringwear_par.errors import InputError
from ringwear_par.schedules import Quantity, Table, breakpoints, largest, told
from ringwear_par.wear.catalogue import LAWS
from ringwear_par.wear.law import Law, WearLaw, complete

#: times closer than this share of them are one
SAME_TIME = 1e-12
_LOADS = {"load.force", "load.pressure", "load.displacement"}


@dataclass(frozen=True)
class Ring:
    """A ring or disc: radii and heights in mm, Young's modulus in MPa.

    ``face`` is the contact face in the body's own frame (see geometry), none the flat one.
    """

    r: tuple[float, float]
    z: tuple[float, float]
    young: float
    poisson: float
    grip: Grip
    face: Polyline = ()


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

    ``tolerance`` (mm) is the largest error of wear of an adaptive step.
    """

    scheme: Literal["implicit", "explicit", "adaptive"]
    step: float = 0.0
    steps: int = 0
    until: float = 0.0
    tolerance: float = 2.5e-6

    @property
    def adaptive(self) -> bool:
        """Whether steps are chosen by the tolerance."""
        return self.scheme == "adaptive"

    @property
    def end(self) -> float:
        """Time at the end, s."""
        return self.until if self.adaptive else self.step * self.steps

    def finished(self, step: int, time: float) -> bool:
        """Tell whether so many steps, to a time (s), are all of them."""
        return time >= self.until if self.adaptive else step >= self.steps


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
    text : the TOML text as run, overrides included.
    """

    lower: Ring
    upper: Ring
    friction: float
    wear_lower: WearLaw | None
    wear_upper: WearLaw | None
    load: Load
    time: Stepping
    mesh: Mesh
    output: Output
    title: str = ""
    text: str = field(default="", compare=False, repr=False)

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
        """(n,) mm, gap at the gap points of the contact line."""
        return self.gap_at(self.line.gap_point)

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
    def laws(self) -> tuple[Law | None, Law | None]:
        """Wear laws of lower and upper, complete."""
        lower, upper = self.wear_lower, self.wear_upper
        return (
            None if lower is None else complete(lower),
            None if upper is None else complete(upper),
        )

    @property
    def area(self) -> float:
        """Nominal contact area, mm^2: of the overlap, whatever the faces."""
        a, b = self.overlap
        return math.pi * (b * b - a * a)

    @property
    def follows_wear(self) -> bool:
        """Whether elements follow the worn profile."""
        return self.mesh.geometry == "updated" and any(law is not None for law in self.laws)

    @cached_property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which a schedule or a parameter bends, s: adaptive steps end there."""
        load = self.load
        inside = {*breakpoints(load.omega, load.force, load.displacement)}
        for law in self.laws:
            inside.update(law.breakpoints if law is not None else ())
        found: list[float] = []
        for time in sorted(t for t in inside if t < self.time.end):
            if not found or time - found[-1] > SAME_TIME * time:
                found.append(time)
        return tuple(found)

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

    def section(self, ring: Ring) -> Section:
        """Return the meridian section of one of the two rings, in its own frame."""
        return Section(ring.r, ring.z[1] - ring.z[0], ring.face)

    @property
    def sections(self) -> tuple[Section, Section]:
        """Meridian sections of lower and upper, each in its own frame."""
        return self.section(self.lower), self.section(self.upper)


def _flatten(tables: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in tables.items():
        path = f"{prefix}{name}"
        if isinstance(value, dict) and path not in BY_PATH:
            flat.update(_flatten(value, f"{path}."))
            if not value and path not in TABLES:  # unknown, and to be told so
                flat[path] = value
        else:
            flat[path] = value
    return flat


def toml_text(flat: Mapping[str, Any]) -> str:
    """Return a TOML text with these dotted keys."""
    tables: dict[str, list[str]] = {"": []}
    for path, value in flat.items():
        table, _, name = path.rpartition(".")
        tables.setdefault(table, []).append(f"{name} = {toml_value(value)}")
    blocks = [
        "\n".join(([f"[{table}]"] if table else []) + lines)
        for table, lines in tables.items()
        if lines
    ]
    return "\n\n".join(blocks) + "\n"


def read_keys(text: str) -> dict[str, Any]:
    """Return the dotted keys and raw values of a case's TOML text."""
    return _flatten(tomllib.loads(text))


def parse_overrides(overrides: Sequence[str]) -> dict[str, Any]:
    """Return dotted keys and values of ``--set a.b=value`` options.

    Raises
    ------
    InputError : an option without "=".
    """
    values: dict[str, Any] = {}
    faults = []
    for item in overrides:
        path, equals, text = item.partition("=")
        if not equals or not path.strip():
            faults.append(f"--set {item}: must be KEY=VALUE, such as load.pressure=50")
            continue
        try:
            values[path.strip()] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            values[path.strip()] = text.strip()
    if faults:
        raise InputError(*faults)
    return values


def read_case(path: Path, overrides: Sequence[str] = ()) -> Case:
    """Read a case file and its overrides. Not collective.

    Raises
    ------
    InputError : all faults, one sentence each.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not a text file in UTF-8") from error
    return parse_case(text, str(path), parse_overrides(overrides), path.parent)


def parse_case(
    text: str,
    name: str,
    overrides: Mapping[str, Any] | None = None,
    folder: Path | None = None,
) -> Case:
    """Make a case of a TOML text; ``name`` is what messages call it. Not collective.

    Files that it names are looked for in ``folder``; the case's own text then has them in full.

    Raises
    ------
    InputError : all faults, one sentence each.
    """
    try:
        flat = read_keys(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{name}: is not valid TOML: {error}") from error
    origin = dict.fromkeys(flat, f"{name}: ")
    found = find_files(flat, folder) if folder is not None else flat
    if not overrides:
        return make_case(found, name, origin, text if found == flat else None)
    overrides = _flatten(overrides)
    origin.update(dict.fromkeys(overrides, "--set "))
    found = override(found, find_files(overrides, Path()))
    return make_case(found, f"{name} with --set", origin)


def find_files(flat: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return dotted keys with the files that they name in full, relative ones from a folder."""
    files = {f"wear.{ring}.file" for ring in ("lower", "upper")}
    return {
        path: str((folder / value).resolve()) if path in files and isinstance(value, str) else value
        for path, value in flat.items()
    }


def override(flat: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return dotted keys with some of them replaced.

    A new load takes the place of the old one; keys without meaning for a new law of wear go;
    ``wear.lower.parameters.NAME`` is one entry of that table.
    """
    overrides = dict(overrides)
    for table in ("wear.lower.parameters", "wear.upper.parameters"):
        named = {p: v for p, v in overrides.items() if p.startswith(f"{table}.")}
        if named:
            before = overrides.get(table, flat.get(table))
            entries = dict(before) if isinstance(before, dict) else {}
            for path, value in named.items():
                entries[path.removeprefix(f"{table}.")] = value
                del overrides[path]
            overrides[table] = entries
    for table in ("wear.lower", "wear.upper"):
        law = overrides.get(f"{table}.law")
        if isinstance(law, str) and law in LAWS:
            known = law_keys(table, law)
            flat = {p: v for p, v in flat.items() if not p.startswith(f"{table}.") or p in known}
    if not _LOADS.isdisjoint(overrides):
        flat = {path: value for path, value in flat.items() if path not in _LOADS}
    return {**flat, **overrides}


def make_case(
    flat: Mapping[str, Any],
    name: str,
    origin: Mapping[str, str] | None = None,
    text: str | None = None,
) -> Case:
    """Make a case of dotted keys and raw values. Not collective.

    Parameters
    ----------
    flat : dotted keys and values, as TOML gives them.
    name : what messages call the case.
    origin : what messages begin with where a key does not come from ``name``.
    text : the case's TOML text, if it is not to be made of the keys.

    Raises
    ------
    InputError : all faults, one sentence each.
    """
    origin, own = origin or {}, f"{name}: "
    faults: list[str] = []
    values: dict[str, Any] = {}
    for path, value in flat.items():
        if path in BY_PATH:
            key = BY_PATH[path]
            try:
                values[path] = key.read(value)
            except RejectedError as reason:
                told = f" ({reason})" if str(reason) else ""
                faults.append(
                    f"{origin.get(path, own)}{path} = {_shortened(value)}: {key.rule}{told}"
                )
        elif path in TABLES:
            said = f"{origin.get(path, own)}{path} = {toml_value(value)}"
            faults.append(f"{said}: must be a table, [{path}]")
        else:
            faults.append(f"{origin.get(path, own)}{path}: unknown key{nearest_key(path)}")
    wears = {
        f"wear.{ring}": any(p.startswith(f"wear.{ring}") for p in flat)
        for ring in ("lower", "upper")
    }
    whose = name.removesuffix(" with --set")
    for key in KEYS:
        if key.path not in flat:
            if key.default is not ...:
                values[key.path] = key.default
            else:
                faults.append(f"{whose}: {key.path} is missing: {key.rule}")
    faults += _inconsistencies(name, values)
    faults += _time_faults(whose, values)
    for table in (table for table, worn in wears.items() if worn):
        faults += law_faults(whose, table, flat, values)
    faces = _faces(name, values, faults)
    if faults:
        raise InputError(*faults)
    case = _build(values, wears, faces, toml_text(flat) if text is None else text)
    _check_contact(name, case, values["load.displacement"])
    return case


def _shortened(value: Any) -> str:
    text = toml_value(value)
    return text if len(text) <= 120 else f"{text[:80]} ... {text[-20:]}"


def nearest_key(path: str) -> str:
    """Return a hint at the known key nearest to an unknown one."""
    near = difflib.get_close_matches(path, BY_PATH, n=1, cutoff=0.6)
    return f" (did you mean {near[0]}?)" if near else ""


def _inconsistencies(name: str, values: Mapping[str, Any]) -> list[str]:
    """Return the faults of keys that are right by themselves but not together."""
    faults = []
    if {"lower.r", "upper.r"} <= values.keys():
        lower, upper = values["lower.r"], values["upper.r"]
        if max(lower[0], upper[0]) >= min(lower[1], upper[1]):
            faults.append(
                f"{name}: upper.r = {list(upper)} and lower.r = {list(lower)}: the rings do not "
                "overlap; their radii must have an interval in common (mm)"
            )
        elif values.get("mesh.contact") is not None:
            low, high = values["mesh.contact"]
            a, b = max(lower[0], upper[0]), min(lower[1], upper[1])
            if low >= b or high <= a:
                faults.append(
                    f"{name}: mesh.contact = [{low:g}, {high:g}]: must have an interval in common "
                    f"with [{a:g}, {b:g}], where the bodies face each other (mm)"
                )
    control = values.get("load.control")
    if values.keys() >= _LOADS:
        force, pressure = values["load.force"], values["load.pressure"]
        displacement = values["load.displacement"]
        if control == "force":
            if displacement is not None:
                faults.append(
                    f"{name}: load.displacement = {told(displacement)}: needs "
                    'load.control = "displacement"'
                )
            elif (force is None) == (pressure is None):
                number = "neither of them is given"
                if force is not None:
                    number = f"both are given ({told(force)} N, {told(pressure)} MPa)"
                faults.append(
                    f'{name}: load.force, load.pressure: {number}; control = "force" needs one'
                )
        elif control == "displacement":
            if displacement is None:
                faults.append(
                    f"{name}: load.displacement is missing: must be a finite number > 0 (mm) where "
                    'load.control = "displacement"'
                )
            for key, value in (("force", force), ("pressure", pressure)):
                if value is not None:
                    faults.append(
                        f"{name}: load.{key} = {told(value)}: must be absent where "
                        'load.control = "displacement"'
                    )
    return faults


def _time_faults(name: str, values: Mapping[str, Any]) -> list[str]:
    """Return the faults of the time steps and the times of output."""
    needed = {"time.scheme", "time.step", "time.steps", "time.end", "output.times", "output.every"}
    if not needed <= values.keys():
        return []
    faults = []
    scheme, end = values["time.scheme"], values["time.end"]
    fixed = {key: values[key] for key in ("time.step", "time.steps")}
    missing = [key for key, value in fixed.items() if value is None]
    if scheme == "adaptive":
        if end is None and missing:
            faults.append(f"{name}: time.end is missing: {BY_PATH['time.end'].rule}")
    else:
        faults += [
            f'{name}: {key} is missing: {BY_PATH[key].rule} where time.scheme = "{scheme}"'
            for key in missing
        ]
        if end is not None:
            faults.append(f'{name}: time.end = {end:g}: needs time.scheme = "adaptive"')
    if end is None and not missing:
        end = fixed["time.step"] * fixed["time.steps"]
    times = values["output.times"]
    if times and end is not None and times[-1] > end * (1.0 + 1e-12):
        faults.append(
            f"{name}: output.times: {times[-1]:g} is after the end; must be <= {end:g} (s)"
        )
    boundary = values.get("output.boundary")
    late = boundary[-1] if isinstance(boundary, tuple) else 0.0
    if end is not None and late > end * (1.0 + 1e-12):
        faults.append(f"{name}: output.boundary: {late:g} is after the end; must be <= {end:g} (s)")
    if times and values["output.every"] != 1:
        faults.append(f"{name}: output.every, output.times: both are given; must be one of them")
    return faults


def _faces(name: str, values: Mapping[str, Any], faults: list[str]) -> dict[str, Polyline]:
    """Return the contact faces of lower and upper in their own frames; add to the faults."""
    faces: dict[str, Polyline] = {"lower": (), "upper": ()}
    for ring in faces:
        profile, chamfer = values.get(f"{ring}.profile"), values.get(f"{ring}.chamfer")
        if profile is not None and chamfer is not None:
            faults.append(
                f"{name}: {ring}.chamfer, {ring}.profile: both are given; must be one or the other"
            )
            continue
        if not {f"{ring}.r", f"{ring}.z"} <= values.keys():
            continue
        r, z = values[f"{ring}.r"], values[f"{ring}.z"]
        found: list[str] = []
        if chamfer is not None:
            inner, outer = chamfer
            if inner is None:  # one number is for the corners that there are
                inner = outer if r[0] > 0 else 0.0
            found = chamfer_faults((inner, outer), r, z)
            if not found:
                faces[ring] = chamfer_face((inner, outer), r)
        if profile is not None:
            found = profile_faults(ring, profile, r, z)
            if not found:
                faces[ring] = profile_face(ring, profile, r, z)
        faults += [f"{name}: {ring}.{fault}" for fault in found]
    return faces


def _check_contact(name: str, case: Case, displacement: Quantity | None) -> None:
    """Raise where the contact line of a case that is complete cannot be."""
    faults = []
    try:
        contact_pieces(case.contact, case.mesh, *case.sections)
    except InputError as error:
        faults += [f"{name}: {fault}" for fault in error.faults]
    if displacement is not None and case.interpenetration > largest(displacement):
        faults.append(
            f"{name}: load.displacement = {told(displacement)}: the undeformed rings "
            f"interpenetrate by {case.interpenetration:g}; must be at least that (mm)"
        )
    here, left = case.smallest_gaps if any(case.open_ends) else (0.0, math.inf)
    if left < here - CLOSE * max(1.0, case.lower.z[1]):
        faults.append(
            f"{name}: mesh.contact = {list(case.contact)}: the undeformed bodies are nearer to "
            f"each other outside, {left:g} mm, than inside; must take in where they meet first"
        )
    if faults:
        raise InputError(*faults)


def _build(
    values: Mapping[str, Any], wears: Mapping[str, bool], faces: Mapping[str, Polyline], text: str
) -> Case:
    def ring(which: str, grip: Grip) -> Ring:
        r, z, young, poisson = (values[f"{which}.{k}"] for k in ("r", "z", "young", "poisson"))
        return Ring(r, z, young, poisson, grip, faces[which])

    case = Case(
        lower=ring("lower", "clamped"),
        upper=ring("upper", values["upper.grip"]),
        friction=values["contact.friction"],
        wear_lower=make_law("wear.lower", values) if wears["wear.lower"] else None,
        wear_upper=make_law("wear.upper", values) if wears["wear.upper"] else None,
        load=Load(values["load.omega"], values["load.force"], values["load.displacement"]),
        time=_stepping(values),
        mesh=Mesh(
            values["mesh.contact_elements"],
            values["mesh.grading"],
            values["mesh.quadrature_tolerance"],
            values["mesh.contact"],
            values["mesh.geometry"],
            values["mesh.geometry_tolerance"],
        ),
        output=Output(
            values["output.every"],
            values["output.fields"],
            values["output.profiles"],
            values["output.times"] or (),
            values["output.boundary"],
        ),
        title=values["title"],
        text=text,
    )
    if values["load.pressure"] is not None:
        pressure, area = values["load.pressure"], case.area
        force: Quantity = (
            Table(pressure.x, tuple(area * p for p in pressure.y))
            if isinstance(pressure, Table)
            else pressure * area
        )
        case = replace(case, load=Load(case.load.omega, force))
    return case


def _stepping(values: Mapping[str, Any]) -> Stepping:
    scheme, step, steps = (values[f"time.{key}"] for key in ("scheme", "step", "steps"))
    if scheme != "adaptive":
        return Stepping(scheme, step, steps)
    end = values["time.end"]
    return Stepping(
        scheme, until=step * steps if end is None else end, tolerance=values["time.tolerance"]
    )
