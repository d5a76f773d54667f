"""Kinds of panels of runs, as ``--panels`` names them: what each shows of the results."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
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

#: a panel, or a function that draws what matplotlib alone draws
Drawing = Panel | partial[None]


class Item(NamedTuple):
    """A result to be drawn."""

    result: Result
    #: that sets it apart
    label: str
    #: its stored states whose profiles or stresses are drawn
    rows: Sequence[int]
    #: whether the user chose these, by steps or times
    chosen: bool


def _pressures(items: Sequence[Item]) -> Iterator[Drawing]:
    top = max(run_panels.pressure_top(result, rows) for result, _, rows, _ in items)
    for result, label, rows, _ in items:
        yield _titled(run_panels.pressure(result, rows, top), label)


def _titled(panel: Panel, label: str) -> Panel:
    return replace(panel, legend="\n".join(filter(None, (label, panel.note))))


def _states(item: Item) -> list[int]:
    """Return the rows of the states that stresses are drawn of, the last one if none is chosen."""
    times = item.result.histories["time"][list(item.rows)].tolist() if item.chosen else []
    return fields.nearest_rows(fields.stresses(item.result)["stress_time"], times)


def _maps(items: Sequence[Item]) -> Iterator[Drawing]:
    top = highest([item.result.stress["stress_grid"][_states(item)] for item in items])
    for item in items:
        for row in _states(item):
            yield partial(draw_map, result=item.result, label=item.label, row=row, top=top)


def _by_result(panels: Callable[[Item], Iterable[Drawing]]) -> Any:
    """Return a function that draws the panels of each result."""
    return lambda items: chain.from_iterable(map(panels, items))


def _shared(panel: Callable[[Sequence[Result], Sequence[str]], Panel]) -> Any:
    """Return a function that draws one panel of all results; a single one needs no label."""

    def draw_all(items: Sequence[Item]) -> list[Drawing]:
        labels = [item.label * (len(items) > 1) for item in items]
        return [panel([item.result for item in items], labels)]

    return draw_all


@dataclass(frozen=True)
class Kind:
    """A kind of panel."""

    #: returns those of results
    drawings: Callable[[Sequence[Item]], Iterable[Drawing]]
    #: raises InputError where a result does not hold what it shows
    needs: Callable[[Result], Any]
    #: whether it shows stored states, which steps and times choose
    rows: bool = True
    #: whether results without it are left out alone, or else all of them
    apart: bool = False
    #: whether results share it, those too whose profiles are not drawn
    shared: bool = False

    def faults(self, result: Result) -> tuple[str, ...]:
        """Return the sentences about what it needs of a result that this does not hold."""
        try:
            self.needs(result)
        except InputError as error:
            return error.faults
        return ()


#: by name
KINDS = {
    "wear": Kind(
        _by_result(lambda item: [
            _titled(run_panels.worn_faces(item.result, None, item.rows), item.label)
        ]),
        lambda result: [run_panels.stored_field(result, f"wear_{body}") for body in BODIES],
        apart=True,
    ),
    "pressure": Kind(
        _pressures, lambda result: run_panels.stored_field(result, "pressure"), apart=True
    ),
    "section": Kind(
        _by_result(lambda item: [partial(draw_section, result=item.result, label=item.label)]),
        lambda result: fields.boundaries(result)[-1], rows=False, apart=True,
    ),
    "stress": Kind(_maps, fields.check_grid),
    "depth": Kind(
        _by_result(lambda item: [along_height(item.result, item.label, _states(item))]),
        fields.check_grid,
    ),
    "interfaces": Kind(
        _by_result(lambda item: along_interfaces(item.result, item.label, _states(item))),
        fields.interfaces_of,
    ),
    "mises": Kind(_shared(largest), fields.stresses, rows=False, shared=True),
    **{
        name: Kind(
            _shared(partial(run_panels.history, quantity=name)), panel.curves, rows=False,
            shared=True,
        )
        for name, panel in HISTORY_PANELS.items()
    },
}  # fmt: skip
