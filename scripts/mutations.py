"""What ``fuzz.py`` does to good input: texts, tables, bytes and HDF5 files spoilt."""

import random
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np

from ringwear_par.results.storage.hdf5 import seal

DEEP = "[" * 2000 + "]" * 2000
NUMBERS = [
    "0", "-0.0", "-1", "1e400", "-1e400", "nan", "inf", "1e308", "1e-308", "5e-324", "1" * 5000,
    "1" * 4000, "0x" + "f" * 5000, "1e15", "999999999999", "1_000", "0b1", "2", "0.5", "1e5",
]  # fmt: skip
VALUES = [
    *NUMBERS, DEEP, "[]", "{}", "true", "1979-05-27T07:32:00Z", "07:32:00", '""', "[1, 2, 3]",
    '"' + "x" * 100_000 + '"', '"\\u0000"', '"a\\u0000b.py"', '"\\u001b[2J"', '"\\u202e"', "[nan]",
    '"$x_$"', '"../../etc/passwd"', '"/dev/null"', '"."', '"threshold"', '"user"', '"adaptive"',
    '"' + "d/" * 3000 + '"', "[[0, 1], [0, 2]]", "[[0, 1], [1, [2]]]", "{ r = 3 }", '["a"]',
    "{ a = { b = 1 } }", "{ r = [[1, 2], [3, 4]] }", "[" + "1, " * 3000 + "1]", "'''\n'''",
    "[[0, nan], [inf, 2]]", "{ linear = [1, 2], count = 3 }", "{ values = [] }",
    "{ log = [0, 1], count = 2 }", "{ linear = [1, 2], count = 100000000000000000000 }",
    "{ values = [[1], {a = 2}, nan] }",
]  # fmt: skip
PIECES = [
    "\0", "\x1b[31m", "\ufeff", "\u2028", "\u202e", "\r", "\n\n", "=", '"', "'''", "[", "]", "[[",
    "#", "{", "}", ",", ";", "\t", "\x7f", "a" * 200_000, ".".join("a" * 1500), "é", "\U0001f600",
    "\\",
]  # fmt: skip
TEXTS = [
    "", "$x_$", "a" * 50_000, "\x1b[2J", "line\nline", "nan", "{}", "[1]", "null", "[[[", DEEP,
    '{"lower": 1}', "\u202e", "complete", "incomplete", "case", "time", "[wear", '["a\\ud800"]',
    "\udc80",
]  # fmt: skip
WORDS = [
    *NUMBERS, "\udcff", "x" * 5000, "x" * 100_000, "a=b", "=", "-", "--", "--nope", "foo", ".", "/",
    "/dev/null", "/proc/self/mem", "1/" + "9" * 20, "1/" + "9" * 5000, "0/0", "2/1", "\x1b[2J",
    "a\nb", "-options_file", "-foo", "nowhere.h5", "", " ", "é", "run.h5", "paper.toml", "lower=3",
    "load.pressure=" + DEEP, "title='''\n'''", "=1", "..=2", "wear=1", "a.b.c=[1", "99999999",
    'title="\\u0000"', "wear.lower.file=\udcff", "time.steps=" + "9" * 5000,
]  # fmt: skip


def mutated_text(rng: random.Random, text: str) -> bytes:
    """Return a text with some things wrong, or with none of it."""
    for _ in range(rng.choice([1, 1, 1, 2, 5])):
        lines = text.split("\n")
        kind = rng.randrange(10)
        at = rng.randrange(len(lines))
        if kind < 4:  # another value
            named = [n for n, line in enumerate(lines) if "=" in line and not line.startswith("#")]
            if named:
                at = rng.choice(named)
                key = lines[at].partition("=")[0]
                lines[at] = f"{key}= {rng.choice(VALUES)}"
        elif kind == 4:  # another key
            key = rng.choice(
                [".".join("a" * 1200), "x" * 90_000, '"\\u001b"', '""', "wear.lower.k"]
            )
            lines.insert(at, f"{key} = {rng.choice(VALUES)}")
        elif kind == 5:
            lines.insert(at, lines[rng.randrange(len(lines))])
        elif kind == 6:
            del lines[at]
        elif kind == 7:
            lines.insert(at, f"[{rng.choice(['lower', 'vary', 'a.b', 'wear.lower', 'x' * 999])}]")
        elif kind == 8:
            place = rng.randrange(len(lines[at]) + 1)
            lines[at] = lines[at][:place] + rng.choice(PIECES) + lines[at][place:]
        else:
            lines[at] = "".join(rng.choice([c, c, c, rng.choice(PIECES)[:1]]) for c in lines[at])
        text = "\n".join(lines) or "x"
    content = text.encode(errors="surrogateescape")
    if rng.random() < 0.1:
        content = mutated_bytes(rng, content)
    return content


def mutated_table(rng: random.Random, text: str) -> bytes:
    """Return a table of comma-separated values with some cells wrong."""
    rows = [line.split(",") for line in text.splitlines()]
    for _ in range(rng.choice([1, 1, 3])):
        row = rng.choice(rows)
        kind, at = rng.randrange(6), rng.randrange(len(row))
        if kind < 3:
            cells = [*VALUES, *PIECES, '"' + "1" * 200_000 + '"', '"', "wear.lower.law", "a;b"]
            row[at] = rng.choice(cells)
        elif kind == 3:
            row.insert(at, rng.choice(NUMBERS))
        elif kind == 4 and len(row) > 1:
            del row[at]
        else:
            rows.append(list(row))
    content = "\n".join(map(",".join, rows)).encode(errors="surrogateescape")
    return mutated_bytes(rng, content) if rng.random() < 0.1 else content


def mutated_bytes(rng: random.Random, content: bytes) -> bytes:
    """Return bytes, damaged as disks and transfers do it."""
    data, kind = bytearray(content), rng.randrange(7)
    at = rng.randrange(len(data))
    if kind < 3:
        data[at] ^= 1 << rng.randrange(8)
    elif kind == 3:
        for _ in range(rng.choice([2, 8, 32])):
            data[rng.randrange(len(data))] = rng.choice([0, 255, rng.randrange(256)])
    elif kind == 4:
        size = rng.choice([8, 64, 512, 4096])
        data[at : at + size] = bytes(len(data[at : at + size]))
    elif kind == 5:
        del data[at:]
    else:
        data[at:at] = rng.randbytes(rng.choice([1, 8, 4096]))
    return bytes(data)


def edited(rng: random.Random, path: Path) -> None:
    """Change a file as a program can that writes HDF5."""
    with h5py.File(path, "r+") as file:
        places = [file]
        file.visititems(lambda _, item: places.append(item))
        for _ in range(rng.choice([1, 1, 3])):
            item = rng.choice(places)
            with suppress(Exception):  # the item is gone, or cannot be that
                if item.attrs and rng.random() < (0.8 if item == file else 0.3):
                    _edit_attribute(rng, item)
                elif isinstance(item, h5py.Dataset):
                    _edit_dataset(rng, item)
                elif item.name != "/":
                    del item.parent[item.name]
    if rng.random() < 0.5:
        seal(path)


def _edit_attribute(rng: random.Random, item: h5py.HLObject) -> None:
    name = rng.choice(sorted(item.attrs))
    if rng.random() < 0.2:
        del item.attrs[name]
        return
    values = [
        *TEXTS, np.nan, np.inf, -1, 0, 2**62, 1e308, np.bytes_(b"\xff"), np.zeros(3), True, 1j,
        h5py.Empty("f"), np.array(["a", "b"], dtype=object), np.float32(3),
    ]  # fmt: skip
    item.attrs[name] = rng.choice(values)


def _edit_dataset(rng: random.Random, item: h5py.Dataset) -> None:
    group, name, values = item.parent, item.name.rpartition("/")[2], item[()]
    kind = rng.randrange(9)
    if kind < 3 and values.dtype.kind in "fi" and values.size:
        flat = values.reshape(-1)
        wrong = [0, -1, 10**9] if values.dtype.kind == "i" else [np.nan, np.inf, -1e308, -1.0]
        flat[rng.randrange(flat.size)] = rng.choice(wrong)
        item[()] = values
        return
    del group[name]
    shape = values.shape
    if kind == 3:
        group.create_dataset(name, data=values[:-1])
    elif kind == 4:
        group.create_dataset(name, data=values[..., None])
    elif kind == 5:  # more than there is anywhere
        group.create_dataset(name, shape=(2**40, *shape[1:]), dtype=values.dtype, chunks=True)
    elif kind == 6:
        kinds = [h5py.string_dtype(), "c16", "i1", "S3", "f4", ">f8", h5py.ref_dtype]
        group.create_dataset(name, shape=shape, dtype=rng.choice(kinds))
    elif kind == 7:
        links = [
            h5py.SoftLink(f"/{name}"), h5py.SoftLink("/nowhere"), h5py.SoftLink("/"),
            h5py.ExternalLink("/nowhere.h5", "/"), h5py.ExternalLink("/dev/null", "/x"),
        ]  # fmt: skip
        group[name] = rng.choice(links)
    elif rng.random() < 0.5:
        group.create_group(name)
    else:
        group.create_dataset(name, data=rng.choice([3.0, h5py.Empty("f"), b"x"]))
