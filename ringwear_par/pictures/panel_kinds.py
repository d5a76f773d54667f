"""Kinds of panels of runs, as ``--panels`` names them: what each shows of the results."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError
from ringwear_par.pictures import run_panels
from ringwear_par.pictures.panel import Panel
from ringwear_par.pictures.run_panels import HISTORY_PANELS
from ringwear_par.pictures.sections import draw_section
from ringwear_par.pictures.stresses import (
    along_height,
    along_interfaces,
    draw_map,
    highest,
    largest,
)
from ringwear_par.results import fields
from ringwear_par.results.result import Result

#: a panel, or a function that draws what is more than curves and bands
Drawing = Panel | partial[None]


class Item(NamedTuple):
    """A result to be drawn."""

    result: Result
    #: that sets it apart
    label: str
    #: s, of its states whose profiles or stresses are drawn; () for the usual ones
    times: Sequence[float]

    @property
    def rows(self) -> list[int]:
        """The stored states whose profiles are drawn."""
        time = self.result.histories["time"]
        if not self.times:
            return run_panels.stages(time)
        return fields.nearest_rows(time, self.times)

    @property
    def stress_rows(self) -> list[int]:
        """The states whose stresses are drawn, the last one if none is chosen."""
        return fields.nearest_rows(fields.stresses(self.result)["stress_time"], self.times)


@dataclass(frozen=True)
class Kind:
    """A kind of panel."""

    #: returns those of results
    drawings: Callable[[Sequence[Item]], Iterable[Drawing]]
    #: raises InputError where a result does not hold what it shows
    needs: Callable[[Result], Any]
    #: whether results share it
    shared: bool = False

    def faults(self, result: Result) -> tuple[str, ...]:
        """Return the sentences about what it needs of a result that this does not hold."""
        try:
            self.needs(result)
        except InputError as error:
            return error.faults
        return ()


def _wear(items: Sequence[Item]) -> list[Drawing]:
    return [_titled(run_panels.worn_faces(i.result, None, i.rows), i.label) for i in items]


def _pressures(items: Sequence[Item]) -> list[Drawing]:
    top = max(run_panels.pressure_top(item.result, item.rows) for item in items)
    return [_titled(run_panels.pressure(i.result, i.rows, top), i.label) for i in items]


def _titled(panel: Panel, label: str) -> Panel:
    return replace(panel, legend="\n".join(filter(None, (label, panel.note))))


def _maps(items: Sequence[Item]) -> list[Drawing]:
    top = highest([item.result.stress["stress_grid"][item.stress_rows] for item in items])
    return [
        partial(draw_map, result=item.result, label=item.label, row=row, top=top)
        for item in items
        for row in item.stress_rows
    ]


def _shared(
    panel: Callable[[Sequence[Result], Sequence[str]], Panel], items: Sequence[Item]
) -> list[Drawing]:
    """Return one panel of all results; a single one needs no label."""
    labels = [item.label * (len(items) > 1) for item in items]
    return [panel([item.result for item in items], labels)]


#: by name
KINDS = {
    "wear": Kind(
        _wear,
        lambda result: [run_panels.stored_field(result, f"wear_{body}") for body in BODIES],
    ),
    "pressure": Kind(_pressures, lambda result: run_panels.stored_field(result, "pressure")),
    "section": Kind(
        lambda items: [partial(draw_section, result=i.result, label=i.label) for i in items],
        lambda result: fields.boundaries(result)[-1],
    ),
    "stress": Kind(_maps, fields.check_grid),
    "depth": Kind(
        lambda items: [along_height(i.result, i.label, i.stress_rows) for i in items],
        fields.check_grid,
    ),
    "interfaces": Kind(
        lambda items: [
            panel for i in items for panel in along_interfaces(i.result, i.label, i.stress_rows)
        ],
        fields.interfaces_of,
    ),
    "mises": Kind(partial(_shared, largest), fields.stresses, shared=True),
    **{
        name: Kind(
            partial(_shared, partial(run_panels.history, quantity=name)), panel.curves, shared=True
        )
        for name, panel in HISTORY_PANELS.items()
    },
}
