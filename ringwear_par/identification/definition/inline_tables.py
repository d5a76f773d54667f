"""Inline tables over several lines, as TOML 1.1 has them and Python's reader of 1.0 has not."""

import re

#: strings, comments, line breaks and braces; whatever else is passed over
_TOKEN = re.compile(
    r""""{3}(?:\\.|[^\\])*?"{3}|'{3}.*?'{3}|"(?:\\.|[^"\\\n])*"|'[^'\n]*'|#[^\n]*|[{}\n]""",
    re.DOTALL,
)


def on_one_line(text: str) -> str:
    """Return a TOML text with every inline table on one line; lines keep their numbers."""
    depth, owed = 0, 0

    def replaced(match: re.Match[str]) -> str:
        nonlocal depth, owed
        token = match[0]
        if token == "{":
            depth += 1
        elif token == "}":
            depth = max(depth - 1, 0)
            if depth == 0:
                token, owed = token + "\n" * owed, 0
        elif depth and token == "\n":
            owed += 1
            return " "
        elif depth and token.startswith("#"):
            return ""
        return token

    return _TOKEN.sub(replaced, text)
