"""The known key that is nearest to an unknown one."""

import difflib
import re
from collections.abc import Iterable

from ringwear_par.cases.schema import BY_PATH, LAYER_KEYS, TABLES, layer_entry

#: what users call the last parts of keys, in small letters without "_" and "-"
_ALIASES: dict[str, tuple[str, ...]] = {
    "angularspeed": ("omega",),
    "angularvelocity": ("omega",),
    "axialforce": ("force",),
    "coefficient": ("friction", "k"),
    "coefficientoffriction": ("friction",),
    "cof": ("friction",),
    "contactpressure": ("pressure",),
    "diameter": ("r",),
    "dt": ("step",),
    "duration": ("end",),
    "e": ("young",),
    "elasticmodulus": ("young",),
    "elements": ("contact_elements",),
    "endtime": ("end",),
    "f": ("force", "friction"),
    "fn": ("force",),
    "height": ("z",),
    "indentation": ("displacement",),
    "load": ("force",),
    "meanpressure": ("pressure",),
    "method": ("scheme",),
    "mode": ("control",),
    "model": ("law",),
    "modulus": ("young",),
    "mu": ("friction",),
    "n": ("force", "contact_elements"),
    "name": ("title",),
    "nelements": ("contact_elements",),
    "normalforce": ("force",),
    "nsteps": ("steps",),
    "nu": ("poisson",),
    "numberofsteps": ("steps",),
    "p": ("pressure",),
    "poissonratio": ("poisson",),
    "poissonsratio": ("poisson",),
    "radii": ("r",),
    "radius": ("r",),
    "rotation": ("omega",),
    "rotationalspeed": ("omega",),
    "rpm": ("omega",),
    "slidingspeed": ("omega",),
    "speed": ("omega",),
    "stiffness": ("young",),
    "tend": ("end",),
    "thickness": ("z",),
    "threshold": ("p0",),
    "timestep": ("step",),
    "tol": ("tolerance",),
    "totaltime": ("end",),
    "u": ("displacement",),
    "until": ("end",),
    "v": ("omega",),
    "velocity": ("omega",),
    "wearcoefficient": ("k",),
    "wearrate": ("k",),
    "youngmodulus": ("young",),
    "youngsmodulus": ("young",),
}
#: least likeness of last parts in one table, of last parts of one or two letters, and elsewhere
_NEAR, _NEAR_SHORT, _NEAR_ELSEWHERE = 0.6, 0.5, 0.75
#: entries of a layer
_LAYER_ENTRIES = tuple(dict.fromkeys(key.path.partition(".")[0] for key in LAYER_KEYS))
#: what is meant as one
_LIKE_A_LAYER = re.compile(r"(lower|upper)\.layers?(?:[\[.](\d{1,3})\]?|\[[^\]]*\])?\.", re.ASCII)
#: longer than any key, and slow to compare
_LONGEST = 100


def unknown_key(path: str) -> str:
    """Return the rule for an unknown key: the nearest known ones, or all keys of its table."""
    hint = nearest_key(path)
    if not hint:
        table = path.rpartition(".")[0]
        known = dict.fromkeys([*BY_PATH, *sorted(TABLES)])
        names = [_last(name) for name in known if name.rpartition(".")[0] == table]
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
    for alias in _ALIASES.get(name, ()):
        if _plain(alias) in by_name:
            return by_name[_plain(alias)]
    likest = difflib.get_close_matches(name, by_name, n=1, cutoff=least)
    return by_name[likest[0]] if likest else []


def _in_table(table: str, paths: list[str]) -> list[str]:
    """Return the paths whose table is most like this one."""

    def likeness(path: str) -> float:
        return difflib.SequenceMatcher(a=table.lower(), b=path.rpartition(".")[0]).ratio()

    best = max(map(likeness, paths), default=0.0)
    return [path for path in paths if likeness(path) == best]
