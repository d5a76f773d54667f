"""Columns of blocks in tables that are padded with NaN."""

from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.studies.storage.blocks import BY_STATE, CaseBlock
from ringwear_par.studies.storage.stored_variables import STORED


def fill(
    table: Any, at: IntArray, values: Any, block: CaseBlock, name: str, places: IntArray
) -> None:
    """Put a column of a block into a table of some of its cases that is padded with NaN.

    Parameters
    ----------
    table : (cases, ...), changed.
    at : rows of the table, those of the cases.
    values : the column.
    block, name : that it is of.
    places : of the cases in the block.
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
