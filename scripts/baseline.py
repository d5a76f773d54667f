#!/usr/bin/env python
"""Record what the program computes, and compare two records: how to change code without results.

    python scripts/baseline.py record before.h5      # on the code as it was, 4 to 6 minutes
    python scripts/baseline.py record after.h5       # on the changed code
    python scripts/baseline.py compare before.h5 after.h5

A record holds every array and text that commands write and print: all case files, a restart and
runs on 2 and 3 ranks, random cases alone and side by side, a sweep of 512 cases on 1, 2 and 3 ranks
and one that was killed and went on, a fit with other laws, a design before and after it. It uses
names that users have (commands, files, ``ringwear_par``), so that it stands while all else moves.
Seconds, versions and numbers of ranks are left out. Records are of one machine: digits differ
between processors and libraries.
"""

import argparse
import csv
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

import ringwear_par as rw

SCRIPTS = Path(__file__).resolve().parent
RINGWEAR = [sys.executable, "-m", "ringwear_par"]
#: what differs between two runs of the same code: clocks, software, ranks, temporary places
_VOLATILE = re.compile(r"(^|/)(seconds\w*|\w*versions?|mpi_library|ranks|lock)$")
_VOLATILE_LINES = re.compile(
    r"seconds|a second|peak memory|time of the ranks|kernel evaluations|starts have ended"
)
#: s that no command takes
_PATIENCE = 900.0
_RANDOM_CASES = 40
_STUDY = """case = "adaptive.toml"
[vary]
"wear.lower.k" = { log = [1e-8, 1e-6], count = 16 }
"wear.lower.p0" = { linear = [0, 60], count = 8 }
"load.pressure" = { linear = [50, 90], count = 4 }
[design]
method = "grid"
"""

Record = dict[str, Any]


def run(*words: str, ranks: int = 0) -> str:
    """Run a command; return what it printed to standard output and error."""
    launcher = ["mpirun", "-n", str(ranks)] if ranks else []
    process = subprocess.run(
        [*launcher, *RINGWEAR, *words], capture_output=True, text=True, timeout=_PATIENCE,
        check=False,
    )  # fmt: skip
    if process.returncode:
        raise SystemExit(f"{' '.join(words)}: status {process.returncode}\n{process.stderr}")
    return process.stdout + process.stderr


def steady_text(text: str, folder: Path) -> str:
    """Return a text without the lines that tell times, and without a folder's name."""
    lines = text.replace(str(folder), "FOLDER").replace(str(SCRIPTS), "SCRIPTS").splitlines()
    return "\n".join(line for line in lines if not _VOLATILE_LINES.search(line))


def steady_numbers(value: Any) -> Any:
    """Return what a JSON file holds without what is volatile."""
    if isinstance(value, dict):
        return {k: steady_numbers(v) for k, v in value.items() if not _VOLATILE.search(k)}
    return [steady_numbers(v) for v in value] if isinstance(value, list) else value


def hdf5_contents(path: Path) -> Record:
    """Return every dataset and attribute of an HDF5 file, by name."""
    contents: Record = {}

    def add(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and not _VOLATILE.search(name):
            value = item.asstr()[()] if item.dtype.kind == "O" else item[()]
            contents[name] = np.asarray(value)

    with h5py.File(path, "r") as file:
        file.visititems(add)
        for name, value in file.attrs.items():
            if not _VOLATILE.search(name):
                contents[f"@{name}"] = np.asarray(value)
    return contents


def folder_contents(folder: Path) -> Record:
    """Return what the files in a folder hold, pictures excepted."""
    contents: Record = {}
    for path in sorted(folder.iterdir()):
        if path.suffix == ".h5":
            contents |= {f"{path.name}/{k}": v for k, v in hdf5_contents(path).items()}
        elif path.name == "cases.csv":
            with path.open(newline="", encoding="utf-8") as file:
                rows = [steady_numbers(row) for row in csv.DictReader(file)]
            contents[path.name] = json.dumps(rows)
        elif path.suffix == ".json":
            numbers = steady_numbers(json.loads(path.read_text(encoding="utf-8")))
            contents[path.name] = steady_text(json.dumps(numbers, sort_keys=True), folder.parent)
        elif path.suffix in (".toml", ".csv"):
            text = path.read_text(encoding="utf-8")
            contents[path.name] = steady_text(text, folder.parent)
    return contents


def record_runs(folder: Path) -> Iterator[tuple[str, Record]]:
    """Record a run of each case file, a restart, and runs on 2 and 3 ranks."""
    paper = SCRIPTS / "cases" / "paper.toml"
    for path in sorted((SCRIPTS / "cases").glob("*.toml")):
        if "[vary]" in path.read_text(encoding="utf-8"):
            continue
        result = folder / f"{path.stem}.h5"
        text = run("run", str(path), "-o", str(result))
        yield f"run/{path.stem}", {"printed": steady_text(text, folder), **hdf5_contents(result)}
    for name in ("paper", "updated", "two_layers"):
        for ranks in (2, 3):
            result = folder / f"{name}_{ranks}.h5"
            run("run", str(SCRIPTS / "cases" / f"{name}.toml"), "-o", str(result), ranks=ranks)
            yield f"run on {ranks} ranks/{name}", hdf5_contents(result)
    result = folder / "restart.h5"
    run("run", str(paper), "-o", str(result), "--set", "time.steps=100")
    run("run", str(paper), "-o", str(result), "--set", "time.steps=200", "--restart")
    yield "restart", hdf5_contents(result)


def record_random_cases(_folder: Path) -> Iterator[tuple[str, Record]]:
    """Record random cases, alone and side by side."""
    # names of users start MPI, after which no mpirun can be started here
    sys.path.insert(0, str(SCRIPTS.parent / "tests" / "helpers"))
    from random_cases import random_case

    names = [f"{number:02d}" for number in range(_RANDOM_CASES)]
    cases = [
        rw.read_case(random_case(np.random.default_rng((7, number)))[0])
        for number in range(_RANDOM_CASES)
    ]
    together = rw.simulate_all(cases)
    for name, case, beside in zip(names, cases, together, strict=True):
        try:
            alone = rw.simulate(case)
        except rw.ComputationError as error:
            yield f"random/{name}", {"error": str(error)}
            continue
        yield f"random/{name}", dataset_contents(alone)
        if isinstance(beside, rw.Result):
            yield f"random side by side/{name}", dataset_contents(beside)
        else:
            yield f"random side by side/{name}", {"error": str(beside.error)}


def dataset_contents(result: "rw.Result") -> Record:
    """Return the arrays of a result and its balances."""
    contents: Record = {str(k): np.asarray(v) for k, v in result.to_xarray().variables.items()}
    return {**contents, "balances": repr(result.balances)}


def record_sweeps(folder: Path) -> Iterator[tuple[str, Record]]:
    """Record a sweep on 1, 2 and 3 ranks, and one that was killed and went on."""
    study = folder / "study.toml"
    study.write_text(_STUDY, encoding="utf-8")
    adaptive = (SCRIPTS / "cases" / "adaptive.toml").read_text(encoding="utf-8")
    (folder / "adaptive.toml").write_text(adaptive, encoding="utf-8")
    for ranks in (1, 2, 3):
        output = folder / f"sweep_{ranks}"
        run("sweep", str(study), "-o", str(output), ranks=ranks)
        yield f"sweep on {ranks} ranks", folder_contents(output)
    output = folder / "sweep_killed"
    words = [*RINGWEAR, "sweep", str(study), "-o", str(output)]
    quiet = subprocess.DEVNULL
    process = subprocess.Popen(words, stdout=quiet, stderr=quiet, start_new_session=True)
    try:
        limit = time.monotonic() + 60.0
        while process.poll() is None and not any(output.glob("blocks/*")):
            if time.monotonic() > limit:
                raise TimeoutError("the sweep has stored nothing in a minute")
            time.sleep(0.02)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    run("sweep", str(study), "-o", str(output))
    yield "sweep, killed and continued", folder_contents(output)


def record_fits(folder: Path) -> Iterator[tuple[str, Record]]:
    """Record a fit with other laws, a design from scratch and one after the fit."""
    fit, plan = SCRIPTS / "fit" / "fit.toml", SCRIPTS / "fit" / "plan.toml"
    for name, words in (
        ("fit", ["fit", str(fit), "-o", str(folder / "fit"), "--compare"]),
        ("design", ["design", str(plan), "-o", str(folder / "design")]),
        ("design after the fit",
         ["design", str(fit), "-o", str(folder / "next"), "--after", str(folder / "fit")]),
    ):  # fmt: skip
        text = run(*words)
        output = Path(words[words.index("-o") + 1])
        yield name, {"printed": steady_text(text, folder), **folder_contents(output)}


PARTS = {
    "runs": record_runs,
    "sweeps": record_sweeps,
    "fits": record_fits,
    "random": record_random_cases,  # the last one: see there
}


def record(path: Path, parts: list[str]) -> None:
    """Write a record of some parts to a new HDF5 file."""
    with tempfile.TemporaryDirectory() as name, h5py.File(path, "x") as file:
        for part, record_part in PARTS.items():
            if part not in parts:
                continue
            started = time.monotonic()
            for item, contents in record_part(Path(name)):
                for key, value in contents.items():
                    text = isinstance(value, str) or value.dtype.kind in "OUS"
                    stored = np.asarray(value, dtype=h5py.string_dtype()) if text else value
                    file[f"{item}/{key}"] = stored
            print(f"{part}: {time.monotonic() - started:.0f} s", flush=True)


def difference(before: Any, after: Any) -> str:
    """Return in what two stored values differ, "" if they are equal to the last bit."""
    if before.dtype.kind == "O" or after.dtype.kind == "O":
        return text_difference(np.ravel(before.asstr()[()]), np.ravel(after.asstr()[()]))
    a, b = before[()], after[()]
    if a.shape != b.shape or a.dtype != b.dtype:
        return f"{a.dtype} {a.shape} became {b.dtype} {b.shape}"
    if a.tobytes() == b.tobytes():
        return ""
    if not np.issubdtype(a.dtype, np.number):
        return "differs"
    with np.errstate(invalid="ignore"):
        largest = np.nanmax(np.abs(np.subtract(b, a, dtype=np.float64)))
        scale = np.nanmax(np.abs(a))
    return f"by {largest:.2g}, {largest / scale if scale else np.inf:.2g} of its largest value"


def text_difference(before: Any, after: Any) -> str:
    """Return the first line in which two lists of texts differ, "" if none does."""
    if len(before) != len(after):
        return f"{len(before)} texts became {len(after)}"
    for one, other in zip(before, after, strict=True):
        lines = one.splitlines(), other.splitlines()
        for a, b in zip(*lines, strict=False):
            if a != b:
                same = [x == y for x, y in zip(a, b, strict=False)]
                start = max(0, (same.index(False) if False in same else len(same)) - 40)
                return f"{a[start : start + 120]!r} became {b[start : start + 120]!r}"
        if one != other:
            return f"{len(lines[0])} lines became {len(lines[1])}"
    return ""


def compare(before: Path, after: Path) -> int:
    """Print in what two records differ; return 1 if they do."""

    def datasets(file: h5py.File) -> dict[str, h5py.Dataset]:
        found: dict[str, h5py.Dataset] = {}
        file.visititems(lambda k, v: found.update({k: v}) if hasattr(v, "shape") else None)
        return found

    with h5py.File(before, "r") as one, h5py.File(after, "r") as other:
        a, b = datasets(one), datasets(other)
        lines = [f"{key}: only {before}" for key in sorted(a.keys() - b.keys())]
        lines += [f"{key}: only {after}" for key in sorted(b.keys() - a.keys())]
        for key in sorted(a.keys() & b.keys()):
            if text := difference(a[key], b[key]):
                lines.append(f"{key}: {text}")
        shared = len(a.keys() & b.keys())
    print("\n".join(lines))
    print(f"{shared} arrays and texts in both: {len(lines)} differences")
    return 1 if lines else 0


def main() -> int:
    """Record or compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    recording = commands.add_parser("record", help="compute and store everything")
    recording.add_argument("path", type=Path, help="a new HDF5 file")
    recording.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    comparing = commands.add_parser("compare", help="tell in what two records differ")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    arguments = parser.parse_args()
    if arguments.command == "compare":
        return compare(arguments.before, arguments.after)
    record(arguments.path, arguments.parts)
    return 0


if __name__ == "__main__":
    sys.exit(main())
