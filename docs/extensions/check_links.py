"""Whether every link inside the built site leads somewhere. Usage: check_links.py FOLDER."""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """The names that a page defines, and the links that it has."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.names: set[str] = {""}
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what an element is called and where it leads."""
        found = dict(attrs)
        self.names.update(filter(None, (found.get("id"), found.get("name"))))
        self.links += filter(None, (found.get("href"), found.get("src")))


def broken(folder: Path) -> list[str]:
    """Return the links within a site that lead to no file, or to no place in it, a line each."""
    pages = {path.resolve(): Page(path.read_text("utf-8")) for path in folder.rglob("*.html")}
    lines = []
    for path, page in pages.items():
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
