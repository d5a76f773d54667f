"""The TOML texts of cases that differ in a few values: one template, with places for these."""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ringwear_par.cases.text import toml_text

_PLACE = re.compile("\0([0-9]+)\0")  # no text of a case has a zero byte


class Place:
    """Stands in a case's keys for the value of a column.

    Parameters
    ----------
    column : its number.
    """

    def __init__(self, column: int) -> None:
        self._column = column

    def __str__(self) -> str:
        return f"\0{self._column}\0"


@dataclass(frozen=True)
class Frame:
    """A text with places for values.

    Parameters
    ----------
    pieces : the texts before, between and after them.
    columns : numbers of the columns that the values come from.
    """

    pieces: tuple[str, ...]
    columns: tuple[int, ...]

    @classmethod
    def of(cls, keys: Mapping[str, Any]) -> "Frame":
        """Return the frame of dotted keys, some of whose values are a Place."""
        pieces = _PLACE.split(toml_text(keys))
        return cls(tuple(pieces[::2]), tuple(map(int, pieces[1::2])))


@dataclass(frozen=True)
class Texts:
    """The texts of some cases.

    Parameters
    ----------
    frames : their pieces, see Frame.
    kinds : which frame each has.
    values : what each has in the places of its frame, as TOML writes it.
    """

    frames: tuple[tuple[str, ...], ...]
    kinds: tuple[int, ...]
    values: tuple[tuple[str, ...], ...]

    @classmethod
    def whole(cls, texts: Sequence[str]) -> "Texts":
        """Return texts that have nothing in common."""
        return cls(tuple((text,) for text in texts), tuple(range(len(texts))), ((),) * len(texts))

    def of_cases(self, cases: Iterable[int]) -> list[str]:
        """Return the texts of some of the cases."""
        return [joined(self.frames[self.kinds[i]], self.values[i]) for i in cases]

    @property
    def longest(self) -> int:
        """Bytes of the longest text."""
        frames = [sum(len(piece.encode()) for piece in frame) for frame in self.frames]
        return max(
            frames[kind] + sum(len(word.encode()) for word in words)
            for kind, words in zip(self.kinds, self.values, strict=True)
        )

    def part(self, cases: Sequence[int]) -> "Texts":
        """Return the texts of some of the cases."""
        kinds, values = [self.kinds[i] for i in cases], [self.values[i] for i in cases]
        numbers = {kind: n for n, kind in enumerate(dict.fromkeys(kinds))}
        frames = tuple(self.frames[kind] for kind in numbers)
        return Texts(frames, tuple(numbers[kind] for kind in kinds), tuple(values))

    def packed(self) -> str:
        """Return all of it as JSON."""
        return json.dumps([self.frames, self.kinds, self.values], ensure_ascii=False)

    @classmethod
    def unpacked(cls, packed: str, count: int) -> "Texts":
        """Return the texts of so many cases.

        Raises
        ------
        ValueError : it is nothing that ``packed`` gives.
        """
        try:
            frames, kinds, values = json.loads(packed)
            pieces = [frames[kind] for kind in kinds]
            places = [len(frame) - 1 for frame in pieces] == [len(row) for row in values]
            words = all(isinstance(w, str) for row in (*frames, *values) for w in row)
        except (LookupError, TypeError, RecursionError) as error:
            raise ValueError(str(error)) from error
        if not (places and words and len(kinds) == count):
            raise ValueError(packed[:72])
        return cls(tuple(map(tuple, frames)), tuple(kinds), tuple(map(tuple, values)))


def joined(pieces: Sequence[str], values: Sequence[str]) -> str:
    """Return a text of its pieces and the values between them."""
    words = [""] * (2 * len(pieces) - 1)
    words[::2], words[1::2] = pieces, values
    return "".join(words)
