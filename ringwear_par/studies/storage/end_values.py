"""The numbers that a sweep tells of each case: in ``cases.csv``, in figures, of surrogates."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.results.variables import (
    HISTORIES,
    LAYER_HISTORIES,
    LAYER_PROFILES,
    LAYER_STRESS,
    LAYER_VOLUMES,
    MAX_MISES,
    TIMES_THROUGH,
    Variable,
)
from ringwear_par.studies.storage.stored_variables import (
    BODY,
    EACH,
    FIELDS,
    STRESS,
    axis_of,
    entries_of,
    told_entry,
)

#: those that all cases have
FINAL = ("penetration", "worn_volume_lower", "worn_volume_upper")
_MM3, _UM = "mm\N{SUPERSCRIPT THREE}", "\N{MICRO SIGN}m"
_ENTRY = re.compile(rf"(.+)\[(\d+|{BODY})\]")


@dataclass(frozen=True)
class Final:
    """A number of each case, or one a layer or point, which have names of their own.

    Parameters
    ----------
    name : of what it is called.
    source : the variable that it is taken of.
    stored : how the results file has it.
    smooth : whether surrogates answer for it: places of the largest stress jump.
    """

    name: str
    source: str
    stored: Variable
    smooth: bool = True

    def of(self, table: FloatArray, last: IntArray) -> FloatArray:
        """Return it of cases, (cases,) or (cases, layers or points), NaN where there is none.

        Parameters
        ----------
        table : (cases, ...) of its source, padded with NaN.
        last : (cases,) row of each case that is taken, -1 for none.
        """
        some = np.flatnonzero(last >= 0)
        if self.source in EACH or (self.source in FIELDS and table.ndim == 2):
            rows = table[some]
        else:
            rows = table[some, last[some]]
        if self.source in FIELDS:
            rows = np.min(rows, axis=-1, where=np.isfinite(rows), initial=np.inf)
            rows = np.where(np.isfinite(rows), rows, np.nan)
        found = np.full((len(table), *rows.shape[1:]), np.nan)
        found[some] = rows
        return found


def _final(name: str, source: Variable, meaning: str = "") -> Final:
    axis = axis_of(source)
    stored = replace(
        source, name=f"final_{name}", dimensions=("case", axis) if axis else ("case",),
        integer=False, meaning=meaning or f"{source.meaning}, at the last stored step",
    )  # fmt: skip
    return Final(name, source.name, stored)


def _stress(source: Variable) -> Final:
    meaning = f"{source.meaning}, at the last time that it is stored of"
    return replace(_final(source.name, source, meaning), smooth=source.unit == "MPa")


def _of_layers() -> Iterable[Final]:
    bodies = (LAYER_VOLUMES, LAYER_HISTORIES, TIMES_THROUGH, LAYER_PROFILES)
    for volumes, share, time, left in zip(*(table.values() for table in bodies), strict=True):
        yield _final(volumes.name, volumes)
        yield _final(share.name, share)
        yield Final(time.name, time.name, replace(time, dimensions=("case",)))
        yield _final(f"least_{left.name}", left, f"least {left.meaning}, at the last stored step")


#: in the order of the table
FINALS = {
    final.name: final
    for final in (
        *(_final(name, HISTORIES[name]) for name in FINAL),
        *_of_layers(),
        *map(_stress, STRESS.values()),
    )
}
#: of each stored variable, what it tells
BY_SOURCE = {final.source: final for final in FINALS.values()}
#: tells which states have stress
STRESS_ASKED = MAX_MISES[0].name


def entry_of(name: str) -> tuple[Final, str]:
    """Return what a number is one of, and which, "" for one that stands alone."""
    found = _ENTRY.fullmatch(name)
    return (FINALS[found[1]], found[2]) if found else (FINALS[name], "")


def entries(final: Final, values: FloatArray) -> dict[str, FloatArray]:
    """Return numbers of cases by their names, the last axis of those that have one taken apart."""
    if not axis_of(final.stored):
        return {final.name: values}
    names = entries_of(final.stored, values.shape[-1])
    return {f"{final.name}[{name}]": values[..., i] for i, name in enumerate(names)}


def last_asked(table: FloatArray) -> IntArray:
    """Return the last row of each case that has stress, -1 for none.

    Parameters
    ----------
    table : (cases, rows) of ``STRESS_ASKED``.
    """
    there = np.isfinite(table)
    last: IntArray = table.shape[1] - 1 - there[:, ::-1].argmax(axis=1)
    return np.where(there.any(axis=1), last, -1)


class Shown(NamedTuple):
    """How a number is drawn: times a factor, and under which name, with its unit."""

    factor: float
    name: str
    unit: str

    @property
    def label(self) -> str:
        """Name and unit."""
        return f"{self.name} ({self.unit})"


_BODY = {
    "worn_volume": Shown(1.0, "worn volume", _MM3),
    "share_through": Shown(100.0, "share worn through", "%"),
    "time_through": Shown(1.0, "worn through from", "s"),
    "least_layer_left": Shown(1e3, "least left of layers", _UM),
}
_SHOWN = {
    "penetration": Shown(1e3, "penetration", _UM),
    "max_mises": Shown(1.0, "largest von Mises stress", "MPa"),
    "max_mises_r": Shown(1.0, "its radius", "mm"),
    "max_mises_z": Shown(1.0, "its height", "mm"),
    "max_mises_layer": Shown(1.0, "its layer", "1"),
    "mises": Shown(1.0, "von Mises stress", "MPa"),
    "max_shear": Shown(1.0, "largest shear stress", "MPa"),
    **{
        f"{name}_{body}": shown._replace(name=f"{shown.name}, {body}")
        for name, shown in _BODY.items()
        for body in ("lower", "upper")
    },
    **{
        name: told._replace(name=f"{told.name}, {body}")
        for table, told in (
            (LAYER_VOLUMES, Shown(1.0, "worn volume", _MM3)),
            (LAYER_STRESS, Shown(1.0, "largest von Mises stress", "MPa")),
        )
        for name, body in zip(table, ("lower", "upper"), strict=True)
    },
}


def shown(name: str) -> Shown:
    """Return how a number is drawn."""
    final, entry = entry_of(name)
    found = _SHOWN[final.name]
    if not entry:
        return found
    return found._replace(name=f"{found.name}, {told_entry(final.stored, entry)}")


def final_name(name: str) -> str:
    """Return what sentences call a number."""
    return f"final {shown(name).name}"


def drawn(final: Mapping[str, Any], cases: Any) -> list[str]:
    """Return which numbers of some cases figures show.

    Volumes of bodies that wear in some of them, or of the lower one; shares worn through, where
    there are some; the largest stress. Numbers of each layer and point would make figures that
    nobody reads.
    """
    worn = [name for name in FINAL[1:] if np.nan_to_num(final[name][cases]).any()]
    through = [name for name in LAYER_HISTORIES if np.nan_to_num(final.get(name, [])).any()]
    stress = [STRESS_ASKED] if STRESS_ASKED in final else []
    return ["penetration", *(worn or ["worn_volume_lower"]), *through, *stress]
