"""Which numbers of a case have a slider, by its raw keys."""

import itertools
from collections.abc import Iterator, Mapping
from typing import Any

from ringwear_par.cases.layers import expanded
from ringwear_par.cases.schema import BY_PATH, key_of
from ringwear_par.cases.tables import Key
from ringwear_par.cases.units import in_unit
from ringwear_par.cases.values import Interval
from ringwear_par.elasticity.sections import BODIES, SHAPE_UNITS
from ringwear_par.explorer.sliders import (
    POSITIONS,
    TIMES,
    Control,
    length,
    nice,
    quantity,
    unit_words,
)
from ringwear_par.wear.law import parameters_of
from ringwear_par.wear.laws import LAWS

_LOADS = ("load.force", "load.pressure", "load.displacement", "load.omega")
_ENTRY = ("inner", "outer")


def controls_of(keys: Mapping[str, Any]) -> list[Control]:
    """Return the controls of a case that is good, by its raw keys, in the order of the page."""
    keys = expanded(keys)
    return [
        *_laws(keys), *_tests(keys), *_times(keys), *_materials(keys), *_layers(keys),
        *_shapes(keys),
    ]  # fmt: skip


def _laws(keys: Mapping[str, Any]) -> Iterator[Control]:
    whose = {
        f"{layer}.wear": f"{body}, layer {number}"
        for body in BODIES
        for number, layer in enumerate(_layers_of(body, keys))
    }
    for table, wears in {**{f"wear.{body}": body for body in BODIES}, **whose}.items():
        if f"{table}.law" not in keys:
            continue
        law = LAWS[keys[f"{table}.law"]]
        group = f"Wear of {wears}: {law.formula}"
        for name, parameter in parameters_of(law).items():
            path = f"{table}.{name}"
            raw = keys.get(path, None if parameter.default is ... else parameter.default)
            if parameter.kind == "parameters":
                for entry, value in (raw or {}).items():
                    meaning = f"parameter of the law of {wears}"
                    yield from quantity(path, entry, value, group, entry, meaning, "", None)
            elif parameter.kind != "file" and raw is not None:
                key = _key(path)
                unit = key.unit.partition(" and ")[2] or parameter.unit
                yield from quantity(
                    path, None, raw, group, name, parameter.meaning, unit_words(unit), key.numbers
                )


def _tests(keys: Mapping[str, Any]) -> Iterator[Control]:
    group = "Load, speed and friction"
    for path in (*_LOADS, "contact.friction"):
        if path in keys:
            key = BY_PATH[path]
            label = path.rpartition(".")[2]
            yield from quantity(
                path, None, keys[path], group, label, key.meaning, unit_words(key.unit), key.numbers
            )


def _materials(keys: Mapping[str, Any]) -> Iterator[Control]:
    for body in BODIES:
        layered = bool(_layers_of(body, keys))  # whose moduli count over that of the body
        for name in ("young", "poisson"):
            key = BY_PATH[f"{body}.{name}"]
            yield from quantity(
                key.path, None, keys[key.path], "Materials", f"{body} {name}", key.meaning,
                unit_words(key.unit), key.numbers, assembles=layered or name == "poisson",
            )  # fmt: skip


def _layers(keys: Mapping[str, Any]) -> Iterator[Control]:
    for body in BODIES:
        for number, layer in enumerate(_layers_of(body, keys)):
            for name in ("thickness", "young", "poisson"):
                key, path = _key(f"{layer}.{name}"), f"{layer}.{name}"
                yield from quantity(
                    path, None, keys[path], f"Layer {number} of {body}", name, key.meaning,
                    unit_words(key.unit), key.numbers, assembles=True,
                )  # fmt: skip


def _layers_of(body: str, keys: Mapping[str, Any]) -> list[str]:
    """Return how the names of entries of layers begin, from the contact face on."""
    starts = (f"{body}.layers[{i}]" for i in itertools.count())
    return list(itertools.takewhile(lambda start: f"{start}.thickness" in keys, starts))


def _key(path: str) -> Key:
    """Return the key of a number of a case."""
    key = key_of(path)
    assert key is not None
    return key


def _shapes(keys: Mapping[str, Any]) -> Iterator[Control]:
    for body in BODIES:
        group = f"Shape of {body}"
        r, z = (in_unit(keys[f"{body}.{name}"], "mm") for name in "rz")
        width, height = r[1] - r[0], z[1] - z[0]
        for place, label in enumerate(("inner radius", "outer radius")):
            yield length(
                f"{body}.r", place, keys, group, label, max(r[place] - 0.5 * width, 0.0),
                r[place] + 0.5 * width,
            )  # fmt: skip
        # the other plane is that of the contact
        if body == "lower":
            ends = z[1] - TIMES * height, z[1] - 0.2 * height
            yield length("lower.z", 0, keys, group, "bottom", *ends)
        else:
            ends = z[0] + 0.2 * height, z[0] + TIMES * height
            yield length("upper.z", 1, keys, group, "top", *ends)
        yield from _faces(body, keys, group)


def _faces(body: str, keys: Mapping[str, Any], group: str) -> Iterator[Control]:
    chamfer, profile = keys.get(f"{body}.chamfer"), keys.get(f"{body}.profile")
    anything, meaning = Interval(0.0, ends=True), BY_PATH[f"{body}.profile"].meaning
    for entry, raw in _places(chamfer):
        label = "chamfer" if entry is None else f"{_ENTRY[entry]} chamfer"
        yield from quantity(
            f"{body}.chamfer", entry, raw, group, label, BY_PATH["upper.chamfer"].meaning, "mm",
            anything, assembles=True,
        )  # fmt: skip
    if isinstance(profile, Mapping):
        ((shape, sizes),) = profile.items()
        if shape not in SHAPE_UNITS or shape == "trace":
            return
        unit = SHAPE_UNITS[shape]
        interval = Interval(-45.0, 45.0) if shape == "cone" else anything
        for place, raw in _places(sizes):
            size = shape if place is None else f"{shape}[{place}]"
            label = shape if place is None else f"{_ENTRY[place]} {shape}"
            yield from quantity(
                f"{body}.profile", size, raw, group, label, meaning, unit, interval, assembles=True
            )


def _places(raw: Any) -> Iterator[tuple[int | None, Any]]:
    """Return the numbers of one, or of a pair, with their places."""
    if isinstance(raw, list):
        yield from enumerate(raw)
    elif raw is not None:
        yield None, raw


def _times(keys: Mapping[str, Any]) -> Iterator[Control]:
    if "time.end" in keys:
        key = BY_PATH["time.end"]
        yield from quantity(
            key.path, None, keys[key.path], "Time", "end", key.meaning, "s", key.numbers
        )
    elif "time.steps" in keys:
        steps = float(keys["time.steps"])
        high = max(TIMES * steps, 10.0)
        step = max(1.0, nice(high / POSITIONS))
        yield Control(
            "time.steps", "time.steps", None, "Time", "steps", BY_PATH["time.steps"].meaning, "",
            False, steps, min(step, steps), high, step, whole=True,
        )  # fmt: skip
