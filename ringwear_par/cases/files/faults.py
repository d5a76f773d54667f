"""What is wrong with a case: keys that nothing reads, and keys that do not go together."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ringwear_par.cases.case import SAME_TIME, Case, RingLayer
from ringwear_par.cases.faces import CLOSE, Shape, contact_face
from ringwear_par.cases.schema import BY_PATH, SCHEMES
from ringwear_par.elasticity.mesh import contact_pieces
from ringwear_par.elasticity.sections import Polyline, corners
from ringwear_par.errors import Fault, InputError
from ringwear_par.files.text import shortened
from ringwear_par.schedules import Quantity, largest, quantity_text

#: most corners of a face: a profile with more is a trace that is not smooth
_MANY_CORNERS = 20
#: the loads: one of them must be given
LOADS = frozenset({"load.force", "load.pressure", "load.displacement"})


@dataclass(frozen=True)
class Origin:
    """Where the keys of a case come from, as messages tell it."""

    #: the file, or what else the case is called
    name: str
    #: dotted keys that were set over its own
    overrides: frozenset[str] = frozenset()
    #: what set them
    setting: str = "--set"

    def prefix(self, path: str) -> str:
        """Return how a sentence about one key begins."""
        overridden = not self.overrides.isdisjoint({path, path.partition("[")[0]})
        return f"{self.setting} " if overridden else f"{self.name}: "

    @property
    def whole(self) -> str:
        """What the case is called with all that was set."""
        return f"{self.name} with {self.setting}" if self.overrides else self.name


def joint_faults(origin: Origin, keys: Mapping[str, Any], values: Mapping[str, Any]) -> list[str]:
    """Return the faults of keys that may be right by themselves but not together.

    Parameters
    ----------
    keys : dotted keys and raw values, as given.
    values : what was read of them, and defaults; without those that are wrong by themselves.
    """
    faults: list[str] = [
        Fault(f"{origin.prefix(path)}{path} = {shortened(keys[path])}: {rule}", path, "conflict")
        for path, rule in unread_keys(keys).items()
    ]
    faults += _overlap_faults(origin.whole, values)
    faults += _load_faults(origin.whole, values)
    faults += _time_faults(origin, values)
    faults += _grid_faults(origin.name, keys)
    return faults


def unread_keys(keys: Mapping[str, Any]) -> dict[str, str]:
    """Return the given keys that have no effect beside the others, and what each must be.

    Parameters
    ----------
    keys : dotted keys and raw values, which may be wrong.
    """

    def value_of(path: str) -> Any:
        return keys.get(path, BY_PATH[path].default)

    unread = {
        "mesh.geometry_tolerance": (
            value_of("mesh.geometry") == "fixed",
            'needs mesh.geometry = "updated"',
        ),
        "output.every": ("output.times" in keys, "must be absent beside output.times"),
        "output.profiles": (
            value_of("output.fields") == [],
            "must be absent where output.fields is empty",
        ),
    }
    scheme = value_of("time.scheme")
    known = isinstance(scheme, str) and scheme in SCHEMES
    adaptive = SCHEMES[scheme].adaptive if known else None
    if adaptive:
        for path in ("time.step", "time.steps"):
            unread[path] = "time.end" in keys, "must be absent beside time.end"
    elif adaptive is False:
        for path in ("time.end", "time.tolerance"):
            unread[path] = True, 'needs time.scheme = "adaptive"'
    return {path: rule for path, (is_unread, rule) in unread.items() if is_unread and path in keys}


def _overlap_faults(name: str, values: Mapping[str, Any]) -> list[Fault]:
    """Return the faults of radii."""
    if not {"lower.r", "upper.r"} <= values.keys():
        return []
    lower, upper, contact = values["lower.r"], values["upper.r"], values.get("mesh.contact")
    a, b = max(lower[0], upper[0]), min(lower[1], upper[1])
    if a >= b:
        fault = (
            f"{name}: upper.r = {list(upper)} and lower.r = {list(lower)}: the rings do not "
            "overlap; their radii must have an interval in common (mm)"
        )
        radii = {"upper": upper, "lower": lower}
        outer = "upper" if upper[0] > lower[0] else "lower"
        inner = "lower" if outer == "upper" else "upper"
        low, high = 0.5 * radii[outer][0], 0.5 * radii[outer][1]
        if radii[inner][0] < high and low < radii[inner][1]:
            fault += f"; if {outer}.r are diameters, write [{low:g}, {high:g}]"
        return [Fault(fault, "upper.r", "conflict")]
    if contact is None or (contact[0] < b and contact[1] > a):
        return []
    fault = (
        f"{name}: mesh.contact = [{contact[0]:g}, {contact[1]:g}]: must have an interval in common "
        f"with [{a:g}, {b:g}], where the bodies face each other (mm)"
    )
    return [Fault(fault, "mesh.contact", "conflict")]


def _load_faults(name: str, values: Mapping[str, Any]) -> list[Fault]:
    """Return the faults of what presses."""
    if not values.keys() >= LOADS:
        return []
    control = values.get("load.control")
    loads = {
        key: f"{name}: load.{key} = {quantity_text(load)}"
        for key in ("force", "pressure", "displacement")
        if (load := values[f"load.{key}"]) is not None
    }
    by_displacement = 'load.control = "displacement"'
    if control == "displacement":
        missing = (
            f"{name}: load.displacement is missing: must be a finite number > 0 (mm) where "
            f"{by_displacement}"
        )
        unread = [
            Fault(f"{load}: must be absent where {by_displacement}", f"load.{key}", "conflict")
            for key, load in loads.items()
        ]
        if "displacement" in loads:
            return unread[:-1]
        return [Fault(missing, "load.displacement", "missing"), *unread]
    if control == "force" and "displacement" in loads:
        fault = f"{loads['displacement']}: needs {by_displacement}"
        return [Fault(fault, "load.displacement", "conflict")]
    if control != "force" or len(loads) == 1:
        return []
    number = "neither of them is given"
    if loads:
        force, pressure = (quantity_text(values[f"load.{key}"]) for key in ("force", "pressure"))
        number = f"both are given ({force} N, {pressure} MPa)"
    fault = f'{name}: load.force, load.pressure: {number}; control = "force" needs one'
    return [Fault(fault, "load.force", "conflict" if loads else "missing")]


def _time_faults(origin: Origin, values: Mapping[str, Any]) -> list[str]:
    """Return the faults of the time steps and the times of output."""
    needed = {"time.scheme", "time.step", "time.steps", "time.end", "output.times"}
    if not needed <= values.keys():
        return []
    faults: list[str] = []
    scheme, end = values["time.scheme"], values["time.end"]
    fixed = {key: values[key] for key in ("time.step", "time.steps")}
    missing = [key for key, value in fixed.items() if value is None]
    if SCHEMES[scheme].adaptive:
        if end is None and missing:
            sentence = f"{origin.name}: time.end is missing: {BY_PATH['time.end'].rule}"
            faults.append(Fault(sentence, "time.end", "missing"))
    else:
        where = f'where time.scheme = "{scheme}"'
        faults += [
            Fault(f"{origin.name}: {key} is missing: {BY_PATH[key].rule} {where}", key, "missing")
            for key in missing
        ]
    if end is None and not missing:
        end = fixed["time.step"] * fixed["time.steps"]
    for key in ("output.times", "output.boundary", "stress.times"):
        times = values.get(key)
        late = times[-1] if isinstance(times, tuple) else 0.0
        if end is not None and late > end * (1.0 + SAME_TIME):
            sentence = f"{origin.whole}: {key}: {late:g} is after the end; must be <= {end:g} (s)"
            faults.append(Fault(sentence, key, "conflict"))
    return faults


def _grid_faults(name: str, keys: Mapping[str, Any]) -> list[Fault]:
    """Return a fault for each key that a grid lacks."""
    table = "stress.grid."
    if not any(path.startswith(table) for path in keys):
        return []
    needed = [key for key in BY_PATH.values() if key.path.startswith(table) and key.default is None]
    return [
        Fault(f"{name}: {key.path} is missing: {key.rule}", key.path, "missing")
        for key in needed
        if key.path not in keys
    ]


def contact_faces(name: str, values: Mapping[str, Any], faults: list[str]) -> dict[str, Polyline]:
    """Return the contact faces of lower and upper in their own frames; add to the faults."""
    faces: dict[str, Polyline] = {"lower": (), "upper": ()}
    for ring in faces:
        profile, chamfer = values.get(f"{ring}.profile"), values.get(f"{ring}.chamfer")
        if profile is not None and chamfer is not None:
            sentence = f"{ring}.chamfer, {ring}.profile: both are given; must be one or the other"
            faults.append(Fault(f"{name}: {sentence}", f"{ring}.profile", "conflict"))
            continue
        if not {f"{ring}.r", f"{ring}.z"} <= values.keys():
            continue
        given = profile
        if chamfer is not None:
            given = Shape("chamfer", tuple(size for size in chamfer if size is not None))
        if given is None:
            continue
        faces[ring], wrong = contact_face(ring, given, values[f"{ring}.r"], values[f"{ring}.z"])
        key = f"{ring}.{'profile' if chamfer is None else 'chamfer'}"
        faults += [Fault(f"{name}: {ring}.{fault}", key, "conflict") for fault in wrong]
    return faces


def layer_faults(
    name: str,
    values: Mapping[str, Any],
    faces: Mapping[str, Polyline],
    layers: Mapping[str, tuple[RingLayer, ...]],
) -> list[str]:
    """Return the faults of layers that are right by themselves but not in their bodies.

    Parameters
    ----------
    values : what was read of the keys.
    faces : contact faces of lower and upper.
    layers : by key, those that are right.
    """
    faults: list[str] = []
    for path, body_layers in layers.items():
        body, total = path.partition(".")[0], sum(layer.thickness for layer in body_layers)
        z = values.get(f"{body}.z")
        if not body_layers:
            continue
        if z is not None and total >= z[1] - z[0]:
            sentence = (
                f"{name}: {path}: are {total:g} mm thick together; must be less than the "
                f"{z[1] - z[0]:g} mm of {body}"
            )
            faults.append(Fault(sentence, path, "conflict"))
        deepest = -min((height for _, height in faces[body]), default=0.0)
        if deepest >= body_layers[0].thickness:
            sentence = (
                f"{name}: {path}[0].thickness = {body_layers[0].thickness:g}: the contact face of "
                f"{body} recedes by {deepest:g} mm; must be more than that, so that it stays "
                "within the top layer"
            )
            faults.append(Fault(sentence, f"{path}[0].thickness", "conflict"))
    if any(layers.values()):
        faults += [
            Fault(
                f'{name}: wear.{body}.law = "non-local": averages over a length; must be a local '
                "law where a body has layers",
                f"wear.{body}.law",
                "conflict",
            )
            for body in ("lower", "upper")
            if values.get(f"wear.{body}.law") == "non-local"
        ]
    return faults


def check_contact(name: str, case: Case, displacement: Quantity | None) -> None:
    """Refuse a case that is complete but whose contact line cannot be.

    Raises
    ------
    InputError : all faults, one sentence each.
    """
    faults: list[str] = []
    try:
        contact_pieces(case.contact, case.mesh, *case.sections)
    except InputError as error:
        rough = [
            body
            for body, ring, section in zip(
                ("lower", "upper"), case.rings, case.sections, strict=True
            )
            if len(ring.face) > _MANY_CORNERS and len(corners(section)) > _MANY_CORNERS
        ]
        hint = f"; {' and '.join(rough)}.profile is rough: smooth it, or give fewer points"
        faults += [
            Fault(f"{name}: {fault}{hint if rough else ''}", "mesh.contact", fault.code)
            for fault in error.faults
        ]
    if displacement is not None and case.interpenetration > largest(displacement):
        sentence = (
            f"{name}: load.displacement = {quantity_text(displacement)}: the undeformed rings "
            f"interpenetrate by {case.interpenetration:g}; must be at least that (mm)"
        )
        faults.append(Fault(sentence, "load.displacement", "conflict"))
    inside, outside = case.smallest_gaps if any(case.open_ends) else (0.0, math.inf)
    if outside < inside - CLOSE * max(1.0, case.lower.z[1]):
        sentence = (
            f"{name}: mesh.contact = {list(case.contact)}: the undeformed bodies are nearer to "
            f"each other outside, {outside:g} mm, than inside; must take in where they meet first"
        )
        faults.append(Fault(sentence, "mesh.contact", "conflict"))
    if faults:
        raise InputError(*faults)
