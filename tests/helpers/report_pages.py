"""Pages of reports as a browser reads them: elements, texts, tables, drawings."""

import base64
import html.parser
import xml.etree.ElementTree as ElementTree

_SVG = "data:image/svg+xml;base64,"


class Read(html.parser.HTMLParser):
    """A page as a browser reads it: elements, and texts of tables."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.tables, self.words, self._inside = [], [], [], []
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
        if inside in ("th", "td"):
            self.tables[-1][-1][-1] += data
        if inside not in ("script", "style"):
            self.words.append(data)

    @property
    def text(self):  # noqa: D102
        return " ".join("".join(self.words).split())

    @property
    def drawings(self):
        """The texts of each drawing, by what it shows."""
        pictures = [attributes for tag, attributes in self.elements if tag == "img"]
        return {
            picture["alt"]: " ".join(
                ElementTree.fromstring(base64.b64decode(picture["src"][len(_SVG) :])).itertext()
            )
            for picture in pictures
            if picture["src"].startswith(_SVG)
        }

    def rows(self, caption_of):
        """Rows of the table whose header has a word, by their first cells."""
        found = [table for table in self.tables if caption_of in table[0]]
        assert len(found) == 1, caption_of
        return {row[0]: row[1:] for row in found[0][1:]}
