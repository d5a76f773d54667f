"""Damaged and malicious input: whatever it is, readers end in a sentence or read it.

    python scripts/fuzz.py [--count 1000] [--seed 1] [--only NUMBER]

Mutates cases, studies, tables, result files, results of sweeps, and command lines, and reads each
in a process of its own; one of ``EVERY`` through the real command. Counts tracebacks, hangs
(``CPU_SECONDS`` of work), crashes, sentences that are none, and files written or changed by what
was refused; ends with status 1 if there is one of them.

Files without their seal are told apart: those are for the HDF5 library alone to find out, which
crashes of some, or never ends.
"""

import argparse
import itertools
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

import matplotlib
from mutations import WORDS, edited, mutated_bytes, mutated_table, mutated_text

from ringwear_par.cases.files.reading import read_case
from ringwear_par.commands import parser
from ringwear_par.errors import InputError, RingwearError
from ringwear_par.files.writing import check_writable
from ringwear_par.history.refusals.cases import check_case
from ringwear_par.options import _refuse_words
from ringwear_par.pictures.figures import plot
from ringwear_par.pictures.style import save_figure
from ringwear_par.reports.report import report
from ringwear_par.results.storage.export import export
from ringwear_par.results.storage.result_files import (
    open_result,
    read_error,
    read_status,
    write_result,
)
from ringwear_par.results.variables import HISTORIES
from ringwear_par.studies.definition.study import read_study
from ringwear_par.studies.pictures.plot import plot_stored
from ringwear_par.studies.storage.blocks import DamagedError
from ringwear_par.studies.storage.ensemble import read_ensemble
from ringwear_par.studies.storage.results_file import read_results_blocks

CASES = Path(__file__).parent / "cases"
SMALL = ["--set", "mesh.contact_elements=8", "time.steps=4"]
#: of a coated ring: stresses of all kinds, at two instants
STRESSED = [
    "--set", "mesh.contact_elements=8", "time.end=20", "stress.times=all", "output.times=[10]",
    'stress.points=[[30, 19.9], [30, 20, "above"]]',
    "stress.grid={r=[28, 32], z=[19.9, 20.1], n=[5, 4]}",
]  # fmt: skip
STRESS_FILES, INTERFACE_FILES = ("b.csv", "b.vtkhdf"), ("c.csv", "c.vtkhdf")
#: an input that takes longer hangs
CPU_SECONDS, WALL_SECONDS = 10, 100
_MEMORY_BYTES = 6 * 2**30
#: one of so many inputs goes through the real command
EVERY = 40
#: share of the files that are drawn as well
_DRAWN = 0.15


# -- readers: of a folder that holds nothing but the input -----------------------------------------


def read_a_case(folder: Path, _: random.Random) -> None:
    path = folder / "case.toml"
    check_case(read_case(path), 1, str(path))


def read_a_study(folder: Path, _: random.Random) -> None:
    study = read_study(folder / "study.toml")
    study.case(0)


def read_a_result(folder: Path, rng: random.Random) -> None:
    path = folder / "run.h5"
    read_status(path)
    read_error(path)
    result = open_result(path)
    looks: list[Callable[[], object]] = [
        result.summary, lambda: repr(result), result.to_xarray, lambda: result.balances,
        lambda: result.doubts, lambda: result.user_laws,
        lambda: write_result(folder / "again.h5", result),
        lambda: export(result, folder / "a.csv", fields=rng.random() < 0.5),
    ]  # fmt: skip
    if result.boundary:
        looks.append(lambda: export(result, folder / "a.vtkhdf"))
        looks.append(lambda: export(path, folder / "d.vtkhdf", scale=10.0))
    if result.stress is not None:
        looks += [
            lambda: export(result, folder / rng.choice(STRESS_FILES), stress=True),
            lambda: export(result, folder / rng.choice(INTERFACE_FILES), interfaces=True),
        ]
    if rng.random() < _DRAWN:
        panels = "wear,penetration,pressure" + ",section" * bool(result.boundary)
        panels += ",stress,depth,mises,interfaces,through" * (result.stress is not None)
        looks.append(lambda: save_figure(plot(path, panels), folder / "a.png"))
    if rng.random() < _DRAWN:
        looks.append(lambda: report(path, folder / "a.html"))
    _look(looks)


def read_an_ensemble(folder: Path, rng: random.Random) -> None:
    path = folder / "results.h5"
    blocks = read_results_blocks(path)
    looks: list[Callable[[], object]] = [lambda: read_ensemble(folder)]
    for block in (blocks or [])[:1]:
        for name in HISTORIES:
            looks.append(partial(block.read, [name]))
        looks.append(partial(block.texts, range(len(block.cases))))
    if rng.random() < _DRAWN:
        looks.append(lambda: plot_stored([folder], folder / "a.png"))
    _look(looks)


def _look(looks: list[Callable[[], object]]) -> None:
    """Do all of it; a refusal, if any, comes last."""
    refused: RingwearError | None = None
    for look in looks:
        try:
            look()
        except DamagedError as error:
            refused = InputError(str(error))  # sweeps mend it, and go on
        except RingwearError as error:
            refused = error
    if refused is not None:
        raise refused


def read_words(folder: Path, _: random.Random) -> None:
    words = json.loads((folder / "words.json").read_text())
    os.chdir(folder)
    cut = words.index("--") if "--" in words else len(words)
    args = parser().parse_args(words[:cut])
    _refuse_words(words[cut + 1 :])
    if "output" in args:
        check_writable(args.output)
    if args.command in ("run", "laws"):
        check_case(read_case(args.path, args.overrides), 1, str(args.path))
    elif args.command == "sweep":
        from ringwear_par.studies.execution.plan import Request

        Request(args.folder, 1, args.ranks_per_case, args.part).check()
        read_study(args.study)
    elif args.command == "plot":
        chosen = args.panels, args.steps, args.profiles_of, args.times
        plot_stored(args.results, args.output, *chosen)
    elif args.command == "export":
        how = args.segments, args.scale, args.fields, args.stress, args.interfaces
        export(args.run, args.output, *how)


# -- inputs ----------------------------------------------------------------------------------------


class Inputs:
    """Good input, and what is made of it.

    Parameters
    ----------
    folder : for it.
    """

    KINDS = ("case", "study", "table", "result", "ensemble", "words", "unsealed")

    def __init__(self, folder: Path) -> None:
        self._cases = sorted(CASES.glob("*.toml"))
        self._texts = {path: path.read_text(encoding="utf-8") for path in self._cases}
        self._law = (CASES / "user_law.py").read_bytes()
        self._runs = []
        few = SMALL[:2]
        for name, words in (
            ("paper", SMALL), ("fields", few), ("user_law", few), ("coated", STRESSED)
        ):  # fmt: skip
            path = folder / f"{name}.h5"
            _command("run", CASES / f"{name}.toml", "-o", path, *words)
            self._runs.append(path.read_bytes())
        text = self._texts[CASES / "paper.toml"].replace("steps = 200", "steps = 4")
        (folder / "paper.toml").write_text(f"{text}\n[mesh]\ncontact_elements = 8\n")
        (folder / "study.toml").write_text(
            'case = "paper.toml"\n[vary]\n"load.pressure" = { linear = [50, 60], count = 3 }\n'
            '"wear.lower.k" = { values = [1e-7, [[0, 1e-7], [1, 2e-7]]] }\n'
        )
        _command("sweep", folder / "study.toml", "-o", folder / "out")
        self._ensemble = (folder / "out" / "results.h5").read_bytes()

    def make(self, number: int, seed: int, folder: Path) -> tuple[str, list[str]]:
        """Put an input into a folder; return its kind, and the words that read it."""
        rng = random.Random(f"{seed} {number}")
        kind = self.KINDS[number % len(self.KINDS)]
        words = getattr(self, f"_make_{kind}")(rng, folder)
        return kind, words

    def _make_case(self, rng: random.Random, folder: Path) -> list[str]:
        text = self._texts[
            rng.choice([p for p in self._cases if p.stem not in ("study", "wear_law")])
        ]
        (folder / "case.toml").write_bytes(mutated_text(rng, text))
        (folder / "user_law.py").write_bytes(self._law)
        return ["laws", "case.toml"]

    def _make_study(self, rng: random.Random, folder: Path) -> list[str]:
        text = self._texts[CASES / rng.choice(["study.toml", "wear_law.toml"])]
        paper = self._texts[CASES / "paper.toml"]
        if rng.random() < 0.2:
            (folder / "paper.toml").write_bytes(mutated_text(rng, paper))
        else:
            (folder / "paper.toml").write_text(paper)
            text = mutated_text(rng, text).decode(errors="surrogateescape")
        (folder / "study.toml").write_bytes(text.encode(errors="surrogateescape"))
        return ["sweep", "study.toml", "-o", "out", "--dry-run"]

    def _make_table(self, rng: random.Random, folder: Path) -> list[str]:
        (folder / "paper.toml").write_text(self._texts[CASES / "paper.toml"])
        study = 'case = "paper.toml"\n[design]\nmethod = "list"\nfile = "table.csv"\n'
        (folder / "study.toml").write_text(study)
        table = "load.pressure,wear.lower.k,upper.r[1]\n50,1e-7,31.5\n60,2e-7,32\n70,3e-7,32.5\n"
        (folder / "table.csv").write_bytes(mutated_table(rng, table))
        return ["sweep", "study.toml", "-o", "out", "--dry-run"]

    def _make_result(self, rng: random.Random, folder: Path) -> list[str]:
        path, content = folder / "run.h5", rng.choice(self._runs)
        if rng.random() < 0.4:
            path.write_bytes(mutated_bytes(rng, content))
        else:
            path.write_bytes(content)
            edited(rng, path)
        return rng.choice(
            [
                ["plot", "run.h5", "-o", "a.png", "--panels", "wear,penetration,pressure"],
                ["plot", "run.h5", "-o", "a.png", "--panels", "stress,depth,interfaces"],
                ["export", "run.h5", "-o", "a.csv"],
                ["export", "run.h5", "-o", "a.csv", "--stress"],
                ["run", str(CASES / "paper.toml"), "-o", "run.h5", *SMALL, "--restart"],
            ]
        )

    def _make_unsealed(self, rng: random.Random, folder: Path) -> list[str]:
        path, content = folder / "run.h5", rng.choice(self._runs)
        path.write_bytes(mutated_bytes(rng, content[: content.rindex(b"\nringwear-par crc32")]))
        return ["export", "run.h5", "-o", "a.csv"]

    def _make_ensemble(self, rng: random.Random, folder: Path) -> list[str]:
        path = folder / "results.h5"
        if rng.random() < 0.4:
            path.write_bytes(mutated_bytes(rng, self._ensemble))
        else:
            path.write_bytes(self._ensemble)
            edited(rng, path)
        return ["plot", ".", "-o", "a.png"]

    def _make_words(self, rng: random.Random, folder: Path) -> list[str]:
        shutil.copy(CASES / "paper.toml", folder)
        shutil.copy(CASES / "study.toml", folder)
        (folder / "run.h5").write_bytes(rng.choice([self._runs[1], self._runs[-1]]))
        words = list(
            rng.choice(
                [
                    ["run", "paper.toml", "-o", "a.h5", *SMALL],
                    ["run", "paper.toml", "-o", "a.h5", *SMALL, "--", "-contact_tao_monitor"],
                    ["sweep", "study.toml", "-o", "out", "--dry-run", "--slice", "1/2"],
                    ["sweep", "study.toml", "-o", "out", "--dry-run", "--ranks-per-case", "1"],
                    ["plot", "run.h5", "-o", "a.png", "--panels", "wear", "--steps", "1,2"],
                    ["export", "run.h5", "-o", "a.vtkhdf", "--revolve", "6"],
                    ["export", "run.h5", "-o", "a.vtkhdf", "--scale", "2"],
                    ["export", "run.h5", "-o", "a.vtkhdf", "--stress"],
                    ["export", "run.h5", "-o", "a.csv", "--interfaces"],
                    ["plot", "run.h5", "-o", "a.png", "--panels", "stress", "--times", "1,2"],
                    ["laws", "paper.toml", "--set", "wear.lower.k=2e-7"],
                ]
            )
        )
        for _ in range(rng.choice([1, 1, 2])):
            at = rng.randrange(1, len(words))
            if rng.random() < 0.6:
                words[at] = rng.choice(WORDS)
            elif rng.random() < 0.5:
                words.insert(at, rng.choice(WORDS))
            elif len(words) > 2:
                del words[at]
        words = [word for word in words if "\0" not in word]
        (folder / "words.json").write_text(json.dumps(words))
        return words


def _command(*words: object) -> None:
    subprocess.run(
        [sys.executable, "-m", "ringwear_par", *map(str, words)], check=True, capture_output=True
    )


READERS = {
    "case": read_a_case, "study": read_a_study, "table": read_a_study, "result": read_a_result,
    "ensemble": read_an_ensemble, "words": read_words, "unsealed": read_a_result,
}  # fmt: skip


# -- one input in a process of its own -------------------------------------------------------------


def contents(folder: Path) -> dict[str, bytes]:
    """Return every file of a folder."""
    return {str(p): p.read_bytes() for p in folder.rglob("*") if p.is_file() and not p.is_symlink()}


def outcome(kind: str, folder: Path, words: list[str], rng: random.Random, real: bool) -> str:
    """Return what came of an input: "read", "refused", or what is wrong with it."""
    before = contents(folder)
    with tempfile.TemporaryFile() as said:
        child = os.fork()
        if child == 0:
            status = 3
            try:
                for number in (1, 2):
                    os.dup2(said.fileno(), number)
                resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS, CPU_SECONDS))
                resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
                if real:
                    os.chdir(folder)
                    line = [sys.executable, "-m", "ringwear_par", *words]
                    os.execv(
                        sys.executable, [word.encode(errors="surrogateescape") for word in line]
                    )
                resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
                status = _read(kind, folder, rng)
            except SystemExit as end:
                status = int(end.code or 0)
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stderr.flush()
                os._exit(status)
        ended = _wait(child)
        said.seek(0)
        text = said.read().decode(errors="replace")
    if ended is None or (
        os.WIFSIGNALED(ended) and os.WTERMSIG(ended) in (signal.SIGXCPU, signal.SIGKILL)
    ):
        return "hang"
    if os.WIFSIGNALED(ended):
        return f"crash: {signal.Signals(os.WTERMSIG(ended)).name}"
    status = os.WEXITSTATUS(ended)
    if "Traceback" in text or status not in (0, 1, 2):
        return f"traceback: {text[-2000:]}"
    if status == 0:
        return "read"
    told = [line for line in text.splitlines() if line.startswith("ringwear: ")]
    if not told or not all(line.isprintable() and len(line) < 1100 for line in told):
        return f"no sentence: {text[-500:]!r}"
    if status == 1 and kind != "words" and words[0] != "run":
        return f"status 1: {text[-500:]}"
    if status == 2 and contents(folder) != before:
        return f"written: {sorted(contents(folder).keys() ^ before.keys())} {told}"
    return "refused"


def _read(kind: str, folder: Path, rng: random.Random) -> int:
    try:
        READERS[kind](folder, rng)
    except RingwearError as error:
        if kind in ("result", "ensemble", "unsealed"):  # others of its uses may have been done
            for path in folder.iterdir():
                if path.name not in ("run.h5", "results.h5") and not path.name.count(".tmp"):
                    path.unlink()
        for line in str(error).splitlines():
            print(f"ringwear: {line}")
        sys.stdout.flush()
        return 2 if isinstance(error, InputError) else 1
    return 0


def _wait(child: int) -> int | None:
    """Return the status of a process, None if it had to be killed."""
    limit = time.monotonic() + WALL_SECONDS
    for nap in itertools.chain([0.002] * 500, itertools.repeat(0.05)):
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return status
        if time.monotonic() > limit:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return None
        time.sleep(nap)
    return None


def main() -> int:
    """Read the inputs; return 1 if one of them does what none may do."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, help="the number of one input, which is kept")
    args = parser.parse_args()
    matplotlib.use("agg")
    warnings.simplefilter("ignore")
    found: Counter[tuple[str, str]] = Counter()
    started = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="fuzz-") as top:
        inputs = Inputs(Path(top))
        numbers = range(args.count) if args.only is None else [args.only]
        for number in numbers:
            folder = Path(top) / f"{number:06d}"
            folder.mkdir()
            kind, words = inputs.make(number, args.seed, folder)
            real = (number // len(inputs.KINDS)) % EVERY == 0
            came = outcome(kind, folder, words, random.Random(number), real)
            found[kind, came.partition(":")[0]] += 1
            if came not in ("read", "refused") and kind != "unsealed":
                print(f"input {number} ({kind}): {words}: {came}", flush=True)
            if args.only is not None:
                kept = shutil.copytree(folder, f"fuzz_{number}", dirs_exist_ok=True)
                print(f"{kind}, {words}: {came}\n{kept}")
            shutil.rmtree(folder)
    for kind in inputs.KINDS:
        told = ", ".join(f"{n} {what}" for (k, what), n in found.items() if k == kind)
        print(f"{kind}: {told}")
    ours = {key: n for key, n in found.items() if key[0] != "unsealed" or key[1] == "traceback"}
    wrong = Counter(dict.fromkeys(("traceback", "hang", "crash", "no sentence", "written"), 0))
    for (_, what), n in ours.items():
        if what not in ("read", "refused"):
            wrong[what] += n
    told = ", ".join(f"{what} {n}" for what, n in wrong.items())
    took = time.perf_counter() - started
    print(f"{sum(found.values())} inputs (seed {args.seed}) in {took:.0f} s: {told}")
    return 1 if wrong.total() else 0


if __name__ == "__main__":
    sys.exit(main())
