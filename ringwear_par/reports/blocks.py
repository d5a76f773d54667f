"""What a page is made of: sections of paragraphs, tables, texts, pictures and charts."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ringwear_par.errors import counted
from ringwear_par.pictures.matplotlib import panel_svg
from ringwear_par.pictures.panel import Panel

SVG = "image/svg+xml"
#: inches of charts beside others, and of those that take the whole width
_NARROW, _WIDE = 4.6, 9.4


@dataclass(frozen=True)
class Lines:
    """A list of sentences."""

    lines: Sequence[str]
    #: whether they speak against the results
    warning: bool = False
    kind = "lines"


@dataclass(frozen=True)
class Tile:
    """A key number in large letters, its name above it."""

    label: str
    value: str
    unit: str = ""
    #: below it, in small letters
    note: str = ""
    #: whether it is a check that was passed; None: it is no check
    good: bool | None = None


@dataclass(frozen=True)
class Tiles:
    """The key numbers at the top of a page, in a row."""

    tiles: Sequence[Tile]
    kind = "tiles"


def checks_tile(doubts: int, note: str = "", wrong: int = 0) -> Tile:
    """Return the tile that says whether the checks were passed.

    Parameters
    ----------
    doubts, wrong : numbers of warnings, and of balances that are wrong.
    """
    words = [counted(doubts, "warning")] if doubts else []
    words += [f"{wrong} wrong"] if wrong else []
    return Tile("checks", ", ".join(words) or "passed", note=note, good=not words)


@dataclass(frozen=True)
class Table:
    """A table; the first cell of a row is its header."""

    caption: str
    header: Sequence[str]
    #: texts, or numbers as their texts
    rows: Sequence[Sequence[str]]
    #: whether it is shown only when it is asked for
    folded: bool = False
    kind = "table"


@dataclass(frozen=True)
class Source:
    """A text that readers may copy, such as a case file."""

    label: str
    text: str
    kind = "source"


@dataclass(frozen=True)
class Picture:
    """A finished picture."""

    caption: str
    content: bytes
    #: MIME type
    form: str
    #: what it shows, for readers who cannot see it
    alt: str
    #: whether it takes the whole width
    wide: bool = True

    @property
    def address(self) -> str:
        """The picture itself, as the address of an image."""
        return f"data:{self.form};base64,{base64.b64encode(self.content).decode()}"


def chart(panel: Panel, alt: str, height: float = 3.2, *, wide: bool = False) -> Picture:
    """Return the picture of a panel, of a height in inches."""
    caption = ", ".join(filter(None, (panel.title, panel.note)))
    drawing = panel_svg(panel, (_WIDE if wide else _NARROW, height))
    return Picture(caption, drawing, SVG, alt, wide)


@dataclass(frozen=True)
class Pictures:
    """Pictures beside each other, as far as there is room."""

    pictures: Sequence[Picture]
    kind = "pictures"


Block = Lines | Tiles | Table | Source | Pictures


@dataclass(frozen=True)
class Section:
    """A part of a page with a heading."""

    heading: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Page:
    """A page."""

    #: what the page is about; above its title
    kind: str
    title: str
    sections: Sequence[Section]
    #: s, after which a browser loads it again; 0: never
    refresh: int = 0

    @property
    def figures(self) -> int:
        """The number of its pictures."""
        blocks = (block for section in self.sections for block in section.blocks)
        return sum(len(block.pictures) for block in blocks if isinstance(block, Pictures))


def reproduced(
    first: str,
    commands: str,
    sources: Sequence[Source],
    versions: Mapping[str, str],
    tables: Sequence[Table] = (),
    data: Mapping[str, str] | None = None,
) -> Section:
    """Return the section about how to compute the same again.

    Parameters
    ----------
    first : what is to be done before the commands are typed.
    versions : of the software.
    data : SHA-256 of files by name.
    """
    blocks: list[Block] = [Lines([first]), Source("Commands", commands), *sources]
    if data:
        blocks.append(Table("Data files, by their SHA-256", ("file", "hash"), [*data.items()]))
    return Section("How to reproduce", [*blocks, *tables, software(versions)])


def stored_versions(attributes: Mapping[str, Any]) -> dict[str, str]:
    """Return the versions of software among the attributes of a file."""
    names = [name for name in attributes if name == "version" or name.endswith("_version")]
    return {n: str(attributes[n]) for n in (*names, "mpi_library") if n in attributes}


def software(versions: Mapping[str, str]) -> Table:
    """Return the table of the versions that computed something."""
    names = {"version": "ringwear-par"}
    rows = [(names.get(n, n.replace("_", " ")), value) for n, value in versions.items()]
    return Table("Software", ("what", "version"), rows)
