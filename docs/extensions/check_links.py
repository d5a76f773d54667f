"""Whether the links inside the built site lead somewhere, and every picture has a text in words.

Usage: check_links.py FOLDER.
"""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """The names that a page defines, the links that it has, and pictures without a text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.names: set[str] = {""}
        self.links: list[str] = []
        self.unnamed: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what an element is called and where it leads."""
        found = dict(attrs)
        self.names.update(filter(None, (found.get("id"), found.get("name"))))
        self.links += filter(None, (found.get("href"), found.get("src")))
        # the gallery's small pictures have their titles beside them
        if tag == "img" and "_thumb." not in (picture := found.get("src") or ""):
            words = (found.get("alt") or "").split()
            self.unnamed += [picture] * (len(words) < 3)


def broken(folder: Path) -> list[str]:
    """Return links within a site that lead nowhere, and pictures without a text, a line each."""
    pages = {path.resolve(): Page(path.read_text("utf-8")) for path in folder.rglob("*.html")}
    lines = []
    for path, page in pages.items():
        lines += [
            f"{path.relative_to(folder.resolve())}: {picture} has no text of three words or more"
            for picture in page.unnamed
        ]
        for link in page.links:
            url = urlsplit(link)
            if url.scheme or url.netloc:
                continue
            target = (path.parent / unquote(url.path)).resolve() if url.path else path
            there = pages[target].names if target in pages else {unquote(url.fragment)}
            if not target.is_file() or unquote(url.fragment) not in there:
                lines.append(f"{path.relative_to(folder.resolve())}: {link} leads nowhere")
    return sorted(set(lines))


if __name__ == "__main__":
    found = broken(Path(sys.argv[1]))
    print(*found, sep="\n", end="\n" if found else "")
    sys.exit(bool(found))
