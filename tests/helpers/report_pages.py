"""Pages of reports as a browser reads them: elements, texts, tables, and charts of Bokeh."""

import html.parser
import json

import numpy as np


def models(value):
    """Yield all models of a document of bokeh."""
    if isinstance(value, dict) and value.get("type") == "object":
        yield value
    if isinstance(value, dict | list):
        for entry in value.values() if isinstance(value, dict) else value:
            yield from models(entry)


def numbers(value):
    """Return a column of a document, its numbers that are none as such."""
    if isinstance(value, dict):
        return float(value["value"])
    return [numbers(entry) for entry in value] if isinstance(value, list) else value


class Drawn:
    """A chart of a page: its columns by kinds of marks, its curves by name, its slider's frames."""

    def __init__(self, name, text):
        self.frames, self.columns = text["frames"], {}
        for model in models(text["item"]["doc"]):
            if model["name"] == "ColumnDataSource":
                kind = model["attributes"]["name"].removeprefix(f"{name}-")
                entries = model["attributes"]["data"]["entries"]
                self.columns[kind] = {column: numbers(values) for column, values in entries}

    def curves(self, *kinds):
        """Abscissae and ordinates of curves, by name."""
        return {
            label: (np.array(x), np.array(y))
            for kind in kinds or ("ends", "lines", "asides")
            for label, x, y in zip(
                *(self.columns[kind][c] for c in ("name", "x", "y")), strict=True
            )
        }


class Read(html.parser.HTMLParser):
    """A page as a browser reads it: elements, texts of tables and of scripts."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.tables, self.scripts, self.words, self._inside = [], [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):  # noqa: D102
        self.elements.append((tag, dict(attrs)))
        if tag in ("script", "style", "title", "th", "td", "h1", "h2", "pre"):
            self._inside = [*self._inside, tag]
        if tag == "table":
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("th", "td"):
            self.tables[-1][-1].append("")

    def handle_endtag(self, tag):  # noqa: D102
        if self._inside and self._inside[-1] == tag:
            self._inside = self._inside[:-1]

    def handle_data(self, data):  # noqa: D102
        inside = self._inside[-1] if self._inside else ""
        if inside == "script":
            self.scripts.append(data)
        elif inside in ("th", "td"):
            self.tables[-1][-1][-1] += data
        if inside not in ("script", "style"):
            self.words.append(data)

    @property
    def text(self):  # noqa: D102
        return " ".join("".join(self.words).split())

    @property
    def charts(self):
        """Charts by the names of their elements."""
        names = [a["id"] for _, a in self.elements if a.get("class") == "plot"]
        texts = [json.loads(text) for text in self.scripts if text.startswith('{"item"')]
        return {name: Drawn(name, text) for name, text in zip(names, texts, strict=True)}

    def rows(self, caption_of):
        """Rows of the table whose header has a word, by their first cells."""
        found = [table for table in self.tables if caption_of in table[0]]
        assert len(found) == 1, caption_of
        return {row[0]: row[1:] for row in found[0][1:]}
