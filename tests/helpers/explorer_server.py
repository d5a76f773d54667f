"""The explorer's command under way."""

import subprocess
from contextlib import contextmanager

from commands import RINGWEAR, SHELL_ENVIRONMENT


@contextmanager
def served(*words, **options):
    """The command, its address, and an end to it."""
    with subprocess.Popen(
        [*RINGWEAR, "explore", *map(str, words), "--no-browser"],
        env=SHELL_ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options,
    ) as process:  # fmt: skip
        try:
            address = process.stdout.readline().strip()
            assert address.startswith("http://127.0.0.1:"), process.stderr.read()
            yield address, process
        finally:
            process.kill()
