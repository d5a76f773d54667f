"""The TOML texts of cases that differ in a few values: one template, with places for these."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ringwear_par.files.text import toml_text

_PLACE = re.compile("\0([0-9]+)\0")  # no text of a case has a zero byte


class Place:
    """Stands in a case's keys for the value of a column, by its number."""

    def __init__(self, column: int) -> None:
        self._column = column

    def __str__(self) -> str:
        return f"\0{self._column}\0"


@dataclass(frozen=True)
class Frame:
    """A text with places for values."""

    #: the texts before, between and after them
    pieces: tuple[str, ...]
    #: numbers of the columns that the values come from
    columns: tuple[int, ...]

    @classmethod
    def of(cls, keys: Mapping[str, Any]) -> "Frame":
        """Return the frame of dotted keys, some of whose values are a Place."""
        pieces = _PLACE.split(toml_text(keys))
        return cls(tuple(pieces[::2]), tuple(map(int, pieces[1::2])))

    def filled(self, values: Sequence[str]) -> str:
        """Return the text with values, as TOML writes them, in its places."""
        words = [""] * (2 * len(self.pieces) - 1)
        words[::2], words[1::2] = self.pieces, values
        return "".join(words)
