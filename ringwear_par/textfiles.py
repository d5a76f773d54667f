"""Users' text files: cases, studies, tables, laws; one reader for all."""

from pathlib import Path

from ringwear_par.errors import InputError


def read_text(path: Path) -> str:
    """Return the text of a user's file, without the byte-order mark that some programs write.

    Raises
    ------
    InputError : there is no such file, it may not be read, or it is no text.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not a text file in UTF-8") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
