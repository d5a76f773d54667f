"""Values of a case's keys, each by itself; wear laws and outlines of sections, made of these.

Of an unknown key, the known one that is nearest.
"""

import difflib
import itertools
import re
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.files.faults import Origin, contact_faces
from ringwear_par.cases.files.keys import read_keys
from ringwear_par.cases.law import Law, faults_together
from ringwear_par.cases.layers import LAYERS, expanded, layer_tables, of_refused_law
from ringwear_par.cases.schema import (
    BY_PATH,
    KEYS,
    LAYER_KEYS,
    TABLES,
    key_of,
    keys_of_layer,
    law_keys,
    layer_entry,
)
from ringwear_par.cases.values import RejectedError
from ringwear_par.elasticity.sections import Section
from ringwear_par.errors import MOST_FAULTS, Fault, InputError, legible
from ringwear_par.files.text import shortened
from ringwear_par.wear.laws import LAWS


def read_values(keys: Mapping[str, Any], origin: Origin) -> tuple[dict[str, Any], list[str]]:
    """Return the values of keys, with defaults, and the faults of single keys.

    Layers are read entry by entry. Keys that are wrong have no value, nor those that a misspelt one
    means.
    """
    faults: list[str] = []
    values: dict[str, Any] = {}
    raw = expanded(keys)
    meant: set[str] = set()
    for path, value in raw.items():
        key = key_of(path)
        if key is not None:
            try:
                values[path] = key.value(value)
            except RejectedError as reason:
                rule = f"{key.rule} ({reason})" if str(reason) else key.rule
                sentence = f"{origin.prefix(path)}{path} = {shortened(value)}: {rule}"
                faults.append(Fault(sentence, path, reason.code))
        elif path in TABLES and value == {}:
            sentence = f"{origin.prefix(path)}[{path}]: is empty; must have one of its keys"
            faults.append(Fault(sentence, path, "missing"))
        elif path in TABLES or (path.endswith(".wear") and path.startswith(LAYERS)):
            subject = f"{path} = {shortened(value)}"
            must = " of a law" if path not in TABLES else f", [{path}]"
            sentence = f"{origin.prefix(path)}{subject}: must be a table{must}"
            faults.append(Fault(sentence, path, "not_allowed"))
        elif not of_refused_law(path, raw):
            few = len(faults) < MOST_FAULTS
            reason_text = unknown_key(path) if few else "unknown key"
            sentence = f"{origin.prefix(path)}{legible(path)}: {reason_text}"
            faults.append(Fault(sentence, path, "unknown_key"))
            meant.update(nearest_keys(path) if few else ())
    for key in itertools.chain(KEYS, *map(keys_of_layer, layer_tables(keys))):
        if key.path not in raw and key.path not in meant:
            if key.default is not ...:
                values[key.path] = key.default
            else:
                sentence = f"{origin.name}: {key.path} is missing: {key.rule}"
                faults.append(Fault(sentence, key.path, "missing"))
    return values, faults


class Outline(NamedTuple):
    """What a section looks like, in the frame of the case."""

    #: (m, 2) float, mm, r and z of the corners around the unworn body; the contact face from the
    #: inner to the outer radius comes first, two corners of the fixed face last
    contour: FloatArray
    #: (l,) float, mm, heights between layers, from the contact face on
    interfaces: FloatArray
    #: mm, height of the contact plane, which depths of the face count from
    plane: float


def outlines(text: str, name: str) -> tuple[Outline, Outline]:
    """Return the outlines of the sections of lower and upper. Not collective.

    Unlike a case, they need no wear laws; no file is opened.

    Parameters
    ----------
    text : TOML text of a case as results have it: in full, with the points of traces.
    name : what messages call it.

    Raises
    ------
    InputError : all faults of their keys, one sentence each.
    """
    keys = {path: v for path, v in read_keys(text, name).items() if not path.startswith("wear.")}
    values, faults = read_values(keys, Origin(name))
    faces = contact_faces(name, values, faults)
    if faults:
        raise InputError(*faults)
    sections = []
    for ring, sign in (("lower", 1.0), ("upper", -1.0)):
        r, z = values[f"{ring}.r"], values[f"{ring}.z"]
        plane, fixed = (z[1], z[0]) if ring == "lower" else z
        section = Section(tuple(r), z[1] - z[0], faces[ring])
        thicknesses = [layer["thickness"] for layer in keys.get(f"{ring}.layers", ())]
        sections.append(
            Outline(
                section.contour(plane, fixed),
                plane - sign * np.cumsum(thicknesses),
                plane,
            )
        )
    return sections[0], sections[1]


def read_law(
    name: str, table: str, keys: Mapping[str, Any], values: Mapping[str, Any], faults: list[str]
) -> Law | None:
    """Return a body's wear law, None where it has none or a wrong one; add to the faults.

    Parameters
    ----------
    name : what messages call the case.
    table : "wear.lower", "wear.upper", or that of a layer, "lower.layers[0].wear".
    keys, values : dotted keys as given, and as read, defaults included; without wrong ones, and
        without those that a misspelt one means.
    faults : what is wrong with the case.
    """
    first = next((path for path in keys if path.startswith(f"{table}.")), None)
    if first is None:
        return None
    if values.get(f"{table}.law", "") is None:
        must = _rule(f"{table}.law")
        sentence = f"{name}: {table}.law is missing: {must} where {first} is given"
        faults.append(Fault(sentence, f"{table}.law", "missing"))
    law = values.get(f"{table}.law")
    if law is None:
        return None
    kind = LAWS[law]
    declared = kind.parameters
    law_faults = [
        Fault(
            f'{table}.{key} is missing: {_rule(f"{table}.{key}")} where {table}.law = "{law}"',
            f"{table}.{key}",
            "missing",
        )
        for key, parameter in declared.items()
        if parameter.default is ... and values.get(f"{table}.{key}", "") is None
    ]
    own_keys = law_keys(table, law)
    where = f'where {table}.law = "{law}"; must be among {", ".join(declared)}'
    law_faults += [
        Fault(f"{path}: has no meaning {where}{_owners(path)}", path, "conflict")
        for path in keys
        if path.startswith(f"{table}.") and path not in own_keys and key_of(path) is not None
    ]
    parameters = {key: values[path] for key in declared if (path := f"{table}.{key}") in values}
    law_faults += faults_together(kind, f"{table}.", parameters)
    result = None
    if not law_faults and len(parameters) == len(declared):
        try:
            result = Law.of_values(law, **parameters)
        except InputError as error:
            law_faults = [Fault(f"{table}.{fault}", table, fault.code) for fault in error.faults]
    faults += [fault.reworded(f"{name}: {fault}") for fault in law_faults]
    return result


def _rule(path: str) -> str:
    key = key_of(path)
    assert key is not None
    return key.rule


def _owners(path: str) -> str:
    """Return the laws that have a parameter, in words."""
    name = path.rpartition(".")[2]
    laws = [f'"{law}"' for law in LAWS if name in LAWS[law].parameters]
    return f" ({name} is of law = {' or '.join(laws)})" if laws else ""


#: what users call the last parts of keys, in small letters without "_" and "-"; of two keys that
#: one name may be of, the first that there is in a table counts
_ALIASES = {
    "omega": "angularspeed angularvelocity rotation rotationalspeed rpm slidingspeed speed v "
    "velocity",
    "force": "axialforce f fn load n normalforce",
    "friction": "coefficient coefficientoffriction cof f mu",
    "k": "coefficient wearcoefficient wearrate",
    "pressure": "contactpressure meanpressure p",
    "displacement": "indentation u",
    "r": "diameter radii radius",
    "z": "height thickness",
    "young": "e elasticmodulus modulus stiffness youngmodulus youngsmodulus",
    "poisson": "nu poissonratio poissonsratio",
    "step": "dt timestep",
    "steps": "nsteps numberofsteps",
    "end": "duration endtime tend totaltime until",
    "tolerance": "tol",
    "contact_elements": "elements n nelements",
    "scheme": "method",
    "control": "mode",
    "law": "model",
    "title": "name",
    "p0": "threshold",
}
#: least likeness of last parts in one table, of last parts of one or two letters, and elsewhere
_NEAR, _NEAR_SHORT, _NEAR_ELSEWHERE = 0.6, 0.5, 0.75
#: entries of a layer
_LAYER_ENTRIES = tuple(dict.fromkeys(key.path.partition(".")[0] for key in LAYER_KEYS))
#: names that are meant as an entry of a layer
_LIKE_A_LAYER = re.compile(r"(lower|upper)\.layers?(?:[\[.](\d{1,3})\]?|\[[^\]]*\])?\.", re.ASCII)
#: longer than any key, and slow to compare
_LONGEST = 100


def unknown_key(path: str) -> str:
    """Return the rule for an unknown key: the nearest known ones, or all keys of its table."""
    hint = nearest_key(path)
    if not hint:
        table = path.rpartition(".")[0]
        names_of_keys = dict.fromkeys([*BY_PATH, *sorted(TABLES)])
        names = [_last(name) for name in names_of_keys if name.rpartition(".")[0] == table]
        if (entry := layer_entry(path)) is not None:
            inner = [key.path.partition("wear.")[2] for key in LAYER_KEYS]
            names = (
                list(filter(None, inner)) if entry[2].startswith("wear.") else list(_LAYER_ENTRIES)
            )
        hint = f"; must be {', '.join(names)}" if table and names else ""
    return f"unknown key{hint}"


def nearest_key(path: str) -> str:
    """Return a hint at the known key nearest to an unknown one, "" where none is near."""
    entry, near = layer_entry(path), nearest_keys(path)
    if entry is not None:  # its own layer needs no name
        near = [key.removeprefix(f"{entry[0]}{entry[1]}.") for key in near]
    return f" (did you mean {' or '.join(near)}?)" if near else ""


def nearest_keys(path: str) -> list[str]:
    """Return the known keys nearest to an unknown one.

    Last parts are compared first, and those of the same table before all others.
    """
    if len(path) > _LONGEST:
        return []
    entry = layer_entry(path)
    if entry is not None:
        near = _near(_last(entry[2]), [key.path for key in LAYER_KEYS], _NEAR_SHORT)
        return [f"{entry[0]}{entry[1]}.{key}" for key in near]
    if (match := _LIKE_A_LAYER.match(path)) is not None:
        near = _near(_last(path), [key.path for key in LAYER_KEYS], _NEAR_SHORT)
        return [f"{match[1]}.layers[{match[2] or 0}].{key}" for key in near]
    table, last = path.rpartition(".")[0], _last(path)
    in_table = [known for known in BY_PATH if known.rpartition(".")[0] == table]
    near = _near(last, in_table, _NEAR if len(last) > 2 else _NEAR_SHORT)
    if not near:
        near = [known for known in BY_PATH if _plain(known, ".") == _plain(path, ".")]
    return near or _in_table(table, _near(last, BY_PATH, _NEAR_ELSEWHERE))


def _plain(name: str, more: str = "") -> str:
    """Return a name in small letters, without separators."""
    return "".join(c for c in name.lower() if c not in "_-" + more)


def _last(path: str) -> str:
    return path.rpartition(".")[2]


def _near(last: str, paths: Iterable[str], least: float) -> list[str]:
    """Return the paths whose last part is this one, has it as another name, or is most like it."""
    name = _plain(last)
    by_name: dict[str, list[str]] = {}
    for path in paths:
        by_name.setdefault(_plain(_last(path)), []).append(path)
    if name in by_name:
        return by_name[name]
    for key, aliases in _ALIASES.items():
        if name in aliases.split() and _plain(key) in by_name:
            return by_name[_plain(key)]
    likest = difflib.get_close_matches(name, by_name, n=1, cutoff=least)
    return by_name[likest[0]] if likest else []


def _in_table(table: str, paths: list[str]) -> list[str]:
    """Return the paths whose table is most like this one."""

    def likeness(path: str) -> float:
        return difflib.SequenceMatcher(a=table.lower(), b=path.rpartition(".")[0]).ratio()

    best = max(map(likeness, paths), default=0.0)
    return [path for path in paths if likeness(path) == best]
