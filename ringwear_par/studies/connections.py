"""Connections to the SQLite files of a sweep."""

import sqlite3
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

#: how long to wait for processes of a killed sweep to end
_BUSY_SECONDS = 5.0
#: most files that are read at the same time: there is one a team, and a process may not open many
_MOST_OPEN = 100


def connect(path: Path) -> sqlite3.Connection:
    """Open a file, or make it; statements stand for themselves."""
    connection = sqlite3.connect(path, timeout=_BUSY_SECONDS, isolation_level=None)
    connection.text_factory = partial(str, encoding="utf-8", errors="replace")
    connection.execute("PRAGMA trusted_schema=OFF")
    # one process a file: its index needs no memory shared with others, which not all disks offer
    connection.execute("PRAGMA locking_mode=EXCLUSIVE")
    return connection


def holds_tables_only(connection: sqlite3.Connection) -> bool:
    """Tell whether a file has plain tables and nothing else.

    A view in the place of a table may have rows without end, and a trigger does things of its own;
    so do columns that are computed, and tables that a module makes up.
    """
    for kind, name, text in connection.execute("SELECT type, name, sql FROM sqlite_master"):
        if kind == "index" and text is None:  # of a primary key
            continue
        if kind != "table" or not text.startswith("CREATE TABLE "):
            return False
        columns = connection.execute("SELECT hidden FROM pragma_table_xinfo(?)", (name,))
        if any(hidden for (hidden,) in columns):
            return False
    return True


def columns_there(connection: sqlite3.Connection, table: str) -> set[str]:
    """Return the columns of a table; none if it is not there."""
    return {row[1] for row in connection.execute(f"PRAGMA table_info({table})")}


class ReadFile:
    """A file that is read: open from a question on, until too many others have been asked since.

    Parameters
    ----------
    path : of the file.
    """

    #: by file, asked longest ago first
    _connections: ClassVar[dict["ReadFile", sqlite3.Connection]] = {}

    def __init__(self, path: Path) -> None:
        self.path = path

    def ask(self, query: str, *values: Any) -> Any:
        """Return a row, which must be there.

        Raises
        ------
        ValueError : it is not.
        """
        there = self._connections
        connection = there.pop(self, None)
        if connection is None:
            while len(there) >= _MOST_OPEN:
                next(iter(there)).close()
            connection = connect(self.path)
        there[self] = connection
        row = connection.execute(query, values).fetchone()
        if row is None:
            raise ValueError(query)
        return row

    def close(self) -> None:
        """Let the file go."""
        connection = self._connections.pop(self, None)
        if connection is not None:
            connection.close()
