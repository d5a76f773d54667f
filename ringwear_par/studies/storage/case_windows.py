"""Windows of cases: what a results file holds of their histories, ready to be written."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.results.fields import side_words
from ringwear_par.results.variables import EDGE_ELEMENT, POINT_SIDE, edge_elements
from ringwear_par.studies.storage.blocks import BY_STATE, CaseBlock
from ringwear_par.studies.storage.case_variables import Chunks
from ringwear_par.studies.storage.end_values import BY_SOURCE, STRESS_STATES, last_with_stress
from ringwear_par.studies.storage.stored_variables import STORED, STRESS, has_layers


class FilledWindow(NamedTuple):
    """What is written of a window of cases."""

    #: of each variable of their histories and of their texts, see ``Chunks.packed``
    chunks: dict[str, Any]
    #: by name, (cases,) or (cases, layers or points)
    end_values: dict[str, FloatArray]


@dataclass(frozen=True, eq=False)
class CaseWindow:
    """Some cases, one after the other in a results file."""

    #: (cases,) of ``case_index.ENTRY``; block -1: not begun
    cases: Any
    #: those that hold the cases, by number
    blocks: Mapping[int, CaseBlock]
    #: of the variables of their histories, by name
    chunks: Mapping[str, Chunks]
    #: of those cases that were not begun
    texts: Sequence[str]
    #: of the texts
    of_texts: Chunks

    def fill(self) -> FilledWindow:
        """Return the chunks and end values of the cases, or DamagedError. Not collective."""
        count = len(self.cases)
        tables: dict[str, Any] = {
            name: np.full((count, *chunks.shape[1:]), np.nan)
            for name, chunks in self.chunks.items()
        }
        for block, at in _by_block(self.cases, self.blocks):
            places, stored = self.cases["place"][at], self.cases["rows"][at] > 0
            if not stored.any():
                continue
            at, places = at[stored], places[stored]
            for name, values in block.read(tables).items():
                if has_layers(STORED[name]):
                    values = body_last(values, tables[name].shape[-1])
                fill(tables[name], at, values, block, name, places)
        if EDGE_ELEMENT.name in tables:
            pressure = tables["pressure"]
            edges = np.where(np.isnan(pressure), np.nan, edge_elements(pressure))
            tables[EDGE_ELEMENT.name] = edges
        end_values = dict(self._end_values(tables))
        if POINT_SIDE.name in tables:
            tables[POINT_SIDE.name] = side_words(tables[POINT_SIDE.name])
        packed = {name: self.chunks[name].packed(table) for name, table in tables.items()}
        texts = texts_of(self.cases, self.blocks, self.texts)
        words = np.array([text.encode() for text in texts], dtype=self.of_texts.kind)
        return FilledWindow({**packed, self.of_texts.name: self.of_texts.packed(words)}, end_values)

    def _end_values(self, tables: Mapping[str, FloatArray]) -> Iterator[tuple[str, FloatArray]]:
        stressed = tables.get(STRESS_STATES)
        for source, end_value in BY_SOURCE.items():
            if source in tables:
                last = self.cases["rows"] - 1
                if source in STRESS and stressed is not None:
                    last = last_with_stress(stressed)
                yield end_value.name, end_value.of(tables[source], last)


def _by_block(cases: Any, blocks: Mapping[int, CaseBlock]) -> Iterator[tuple[CaseBlock, IntArray]]:
    """Yield the blocks of those cases that were begun, with the places of these among all."""
    numbers = cases["block"]
    order = np.argsort(numbers, kind="stable")
    order = order[np.count_nonzero(numbers < 0) :]
    for at in np.split(order, np.flatnonzero(np.diff(numbers[order])) + 1):
        if len(at):
            yield blocks[int(numbers[at[0]])], at


def texts_of(cases: Any, blocks: Mapping[int, CaseBlock], missing: Sequence[str] = ()) -> list[str]:
    """Return the texts of some cases, see ``CaseWindow``; ``missing``: of those not begun."""
    texts = np.empty(len(cases), dtype=object)
    texts[cases["block"] < 0] = missing
    for block, at in _by_block(cases, blocks):
        texts[at] = block.texts(cases["place"][at].tolist())
    return texts.tolist()


def fill(
    table: Any, at: IntArray, values: Any, block: CaseBlock, name: str, places: IntArray
) -> None:
    """Put a column of a block into a table (cases, ...) of some of its cases, padded with NaN.

    Rows ``at`` of the table are of the cases at ``places`` of the block.
    """
    lengths = block.offsets[places + 1] - block.offsets[places]
    cells = tuple(map(slice, np.minimum(table.shape[2:], values.shape[1:]).tolist()))
    if block.axes[name] != BY_STATE:
        values = values if len(values) == 1 else values[places]
        if "step" not in STORED[name].dimensions or table.ndim == values.ndim:
            cells = tuple(map(slice, np.minimum(table.shape[1:], values.shape[1:]).tolist()))
            table[(_run(at), *cells)] = values[(slice(None), *cells)]
        else:  # the last of a field that the table has at all states
            table[(at, lengths - 1, *cells)] = values[(slice(None), *cells)]
        return
    if not lengths.sum():
        return
    values = values[(slice(None), *cells)]
    starts, to, taken = block.offsets[places], _run(at), _run(places)
    if isinstance(to, slice) and isinstance(taken, slice):
        part, longest = values[starts[0] : starts[0] + lengths.sum()], int(lengths.max())
        inside = table[(to, slice(longest), *cells)]
        if (lengths == longest).all():
            inside[...] = part.reshape(inside.shape)
        else:
            inside[np.arange(longest) < lengths[:, None]] = part
        return
    step = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    table[(np.repeat(at, lengths), step, *cells)] = values[step + np.repeat(starts, lengths)]


def body_last(values: FloatArray, width: int) -> FloatArray:
    """Return a column by layer with so many of these, the body itself the last of them.

    Cases may have fewer layers than others of their sweep: these have NaN before the body.
    """
    layers = values.shape[-1] - 1
    if layers + 1 == width:
        return values
    wider = np.full((*values.shape[:-1], width), np.nan)
    wider[..., :layers], wider[..., -1] = values[..., :-1], values[..., -1]
    return wider


def _run(numbers: IntArray) -> slice | IntArray:
    """Return increasing numbers without gaps as a slice, others as they are."""
    first, last = int(numbers[0]), int(numbers[-1])
    if last - first + 1 == len(numbers) and (np.diff(numbers) == 1).all():
        return slice(first, last + 1)
    return numbers
