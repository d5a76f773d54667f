"""A command again and again, while less or more room is left for what it writes.

    python full_disk.py "disk" or "limit" < what to do, in JSON

Prints as JSON what became of each command: its status and what it said.
Of its own, as what happened where HDF5 heard of a full disk was the end of the process.
"""

import json
import os
import re
import resource
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

#: where all is well
_ROOMY = 64_000_000


@contextmanager
def _room(kind, folder, size):
    """Let files in a folder have so many bytes, together or (limit) each."""
    if kind == "disk":
        resize(folder, size)
        yield
        resize(folder, _ROOMY)
    else:
        hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
        yield
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))


def resize(folder, size):
    """Give a tmpfs another size, bytes."""
    mount = ["mount", "-o", f"remount,size={size}", str(folder)]
    subprocess.run(mount, check=True, timeout=20)


def _said(words):
    """Run a command in this process; return its status and its lines on standard error.

    But for the progress that a busy machine shows.
    """
    from ringwear_par.cli import main

    with tempfile.TemporaryFile() as file:
        before = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            status = main(words)
            sys.stderr.flush()
        finally:
            os.dup2(before, 2)
            os.close(before)
        file.seek(0)
        lines = file.read().decode().splitlines()
        return status, [line for line in lines if not re.search(": step [0-9]+, time", line)]


def _run(kind, folder, before, words, sizes, keep, checkpoint_seconds=1e9, again=False):
    """Yield status and sentences of a command at each size.

    Parameters
    ----------
    kind : "disk": the folder is a tmpfs; "limit": no file may be larger.
    folder : where it writes.
    before : files and folders to be there before, by name there: where to copy them from.
    words : of the command.
    sizes : bytes that are left beside the files before.
    keep : folder to copy what is left to, by size.
    checkpoint_seconds : between checkpoints.
    again : whether to try again with all room, and to keep what is left then, too.
    """
    from shutil import copy, copytree, rmtree

    from ringwear_par.results.execution import run as run_command

    run_command.CHECKPOINT_SECONDS = checkpoint_seconds
    for size in sizes:
        for path in folder.iterdir():
            rmtree(path) if path.is_dir() else path.unlink()
        for name, source in before.items():
            (copytree if Path(source).is_dir() else copy)(source, folder / name)
        pages = sum(-(-path.stat().st_size // 4096) for path in folder.rglob("*.*"))
        with _room(kind, folder, size + (4096 * pages if kind == "disk" else 0)):
            status, said = _said(words)
        told = [status, said]
        copytree(folder, Path(keep) / str(size))
        if again:
            status, said = _said(words)
            told += [status, said]
            copytree(folder, Path(keep) / f"{size}_again")
        yield told


def main():
    sys.stdout, results = open(os.devnull, "w"), sys.stdout  # noqa: SIM115
    told = json.load(sys.stdin)
    told["folder"] = Path(told["folder"])
    json.dump(list(_run(sys.argv[1], **told)), results)


if __name__ == "__main__":
    main()
