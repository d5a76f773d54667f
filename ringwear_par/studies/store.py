"""The folder of a sweep: which cases it holds, and where.

``results.h5`` and ``cases.csv`` are written when a sweep ends; until then its cases are in
``shards``, those that a stop interrupted in ``inflight``, shared operators in ``operators``. Slices
of a study keep to files of their own until the whole is merged.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import h5py

from ringwear_par.errors import InputError
from ringwear_par.history.balances import Balances
from ringwear_par.results.files import open_result
from ringwear_par.results.variables import PROFILES
from ringwear_par.studies import dataset, shards
from ringwear_par.studies.dataset import RESULTS, Row
from ringwear_par.studies.shards import Entry, Record

_FOLDERS = ("shards", "inflight", "operators")


@dataclass(frozen=True)
class Store:
    """Names in a sweep's folder.

    Parameters
    ----------
    folder : of the sweep.
    part : "" for the whole, or the slice, such as "2-8".
    """

    folder: Path
    part: str = ""

    def shard(self, team: int) -> Path:
        """Return the file that a team writes to."""
        return self.folder / "shards" / f"{self.part or 'all'}_{team:04d}.sqlite"

    def inflight(self, identity: str) -> Path:
        """Return the file of a case that was interrupted."""
        return self.folder / "inflight" / f"{identity}.h5"

    def operator(self, group: int) -> Path:
        """Return the file of a group's operator."""
        return self.folder / "operators" / f"{self.part or 'all'}_{group}.npy"

    @property
    def stopped(self) -> Path:
        """The file that is there after a stop: run the same command again."""
        return self.folder / f"STOPPED{'.' if self.part else ''}{self.part}"

    def open(self) -> None:
        """Make the folders, and clear what a killed sweep left half done.

        Raises
        ------
        InputError : the folder cannot be written.
        """
        try:
            for name in _FOLDERS:
                (self.folder / name).mkdir(parents=True, exist_ok=True)
            probe = self.folder / f"probe{self.part}"
            probe.touch()
            probe.unlink()
        except OSError as error:
            raise InputError(f"{self.folder}: cannot be written: {error.strerror}") from error

    def clear(self) -> None:
        """Remove what a killed sweep left half done. Needs the folder's lock."""
        self.stopped.unlink(missing_ok=True)
        left = [*(self.folder / "operators").glob(f"{self.part or '*'}_*")]
        if not self.part:
            left += [*self.folder.glob("STOPPED.*"), *self.folder.glob("*.tmp*")]
            left += [*(self.folder / "inflight").glob("*.tmp*")]
        for path in left:
            path.unlink(missing_ok=True)

    def scan(self, mend: bool) -> tuple[dict[str, Entry], list[str]]:
        """Return the stored cases by id, and sentences on what is damaged. Needs the lock.

        Parameters
        ----------
        mend : move damaged files aside.

        Raises
        ------
        ComputationError : a shard is in use by a process of a killed sweep.
        """
        entries: dict[str, Entry] = {}
        notes = []
        results = self.folder / RESULTS
        if results.exists():
            found = dataset.read_entries(results)
            if found is None:
                aside = results.with_name("results.damaged.h5")
                if mend:
                    with suppress(FileNotFoundError):  # another slice was first
                        results.replace(aside)
                notes.append(f"{results}: is damaged (kept as {aside.name}); its cases run again")
            entries.update(found or {})
        for path in sorted((self.folder / "shards").glob(f"{self.part or '*'}_*.sqlite")):
            found = shards.read_index(path)
            if found is None:
                aside = path.with_suffix(".damaged")
                if mend:
                    path.replace(aside)
                    for tail in ("-wal", "-shm"):
                        Path(f"{path}{tail}").unlink(missing_ok=True)
                notes.append(f"{path}: is damaged (kept as {aside.name}); its cases run again")
            for identity, entry in (found or {}).items():  # a failure never hides a success
                if entries.get(identity, _NOTHING).status != "done":
                    entries[identity] = entry
        for path in sorted((self.folder / "inflight").glob("*.h5")):
            if entries.get(path.stem, _NOTHING).status not in ("done", "failed"):
                interrupted = _interrupted(path)
                if interrupted is None:
                    if not path.exists():  # another slice has just ended the case
                        continue
                    if mend:
                        path.unlink(missing_ok=True)
                    notes.append(f"{path}: is damaged; this case starts anew")
                else:
                    entries[path.stem] = interrupted
        return entries, notes

    def fetch(self, rows: Sequence[Row]) -> Iterator[Record]:
        """Yield the records of stored cases, in any order."""
        places: dict[Path, list[str]] = defaultdict(list)
        for row in rows:
            if row.entry is not None:
                places[row.entry.path].append(row.id)
        for path, ids in places.items():
            if path.suffix == ".sqlite":
                yield from shards.read_records(path, ids)
            elif path.name == RESULTS:
                yield from dataset.read_records(path, ids)
            else:
                yield _interrupted_record(path)

    def forget_shards(self) -> None:
        """Remove what results.h5 holds by now."""
        for path in (self.folder / "shards").glob("*.sqlite*"):
            path.unlink(missing_ok=True)
        for name in _FOLDERS:  # what is damaged or interrupted stays
            with suppress(OSError):
                (self.folder / name).rmdir()


_NOTHING = Entry("", 0, 0, (), False, Path(), "")


def _interrupted(path: Path) -> Entry | None:
    try:
        with h5py.File(path, "r") as file:
            fields = tuple(name for name in PROFILES if name in file)
            deep = any(file[name].ndim == 2 for name in fields)
            stored, elements, version = len(file["time"]), len(file["r"]), file.attrs["version"]
            return Entry("incomplete", stored, elements, fields, deep, path, str(version))
    except (OSError, KeyError, RuntimeError):
        return None


def _interrupted_record(path: Path) -> Record:
    result = open_result(path)
    arrays = {
        "step": result.step,
        **result.histories,
        "r": result.line.r,
        "width": result.line.width,
        **result.profiles,
    }
    about, worst = result.attributes, Balances(**result.balances).worst
    return Record(
        path.stem, result.case, "incomplete", "", float(about["seconds_stepping"]), worst, arrays,
        str(about["version"]),
    )  # fmt: skip
