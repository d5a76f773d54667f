"""Bad input of every kind of file: ``tests/faults.toml`` says the key, the code and the words."""

import pickle
import shutil
import tomllib

import pytest
from parts import main
from paths import CASES, FIT, PAPER, ROOT

import ringwear_par as rw

FAULTS = tomllib.loads((ROOT / "tests/faults.toml").read_text(encoding="utf-8"))
BASES, COMMANDS = FAULTS.pop("bases"), FAULTS.pop("command")
ALL = [(kind, fault) for kind, faults in FAULTS.items() for fault in faults]


def merged(base, changes):
    """Return tables with some of them changed; those of a list by their numbers."""
    if not isinstance(changes, dict) or not isinstance(base, dict | list):
        return changes
    if isinstance(base, list) and not all(map(str.isdigit, changes)):
        return changes
    tables = dict(base) if isinstance(base, dict) else dict(enumerate(base))
    for name, value in changes.items():
        key = name if isinstance(base, dict) else int(name)
        tables[key] = merged(tables.get(key), value)
    tables = {name: value for name, value in tables.items() if value != "(absent)"}
    return tables if isinstance(base, dict) else [*tables.values()]


def edited(path, edit):
    """Replace a part of a file's text by another, or append it."""
    old, new = (text.encode() for text in edit)
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new, 1) if old else content + new)


def dotted(tables, prefix=""):
    """Return tables of a case as overrides of single keys; a table that is a value stays one."""
    keys = {}
    for name, value in tables.items():
        path = f"{prefix}{name}"
        whole = not isinstance(value, dict) or (set(value) <= {"r"} and "." in path)
        keys |= {path: value} if whole or not value else dotted(value, f"{path}.")
    return keys


def case(fault, folder):
    path = CASES / f"{fault.get('base', 'paper')}.toml"
    if "edit" in fault:
        path = shutil.copy(path, folder / "case.toml")
        edited(path, fault["edit"])
    rw.simulate(rw.read_case(path, fault.get("options") or dotted(fault.get("set", {}))))


def study(fault, folder):
    (folder / "rows.csv").write_text(fault.get("rows", ""))
    (folder / "study.toml").write_text(fault.get("edit", ["", ""])[1])
    tables = merged({"case": str(PAPER)}, fault.get("set", {}))
    if "rows" in fault:
        tables["design"]["file"] = str(folder / "rows.csv")
    rw.read_study(folder / "study.toml" if "edit" in fault else tables)


def fit(fault, folder):
    read = rw.design if fault.get("plans", True) else rw.fit
    read(merged(BASES["fit"], fault["set"]))


def readings(fault, folder):
    (folder / "z.csv").write_text(fault["text"])
    tables = merged(BASES["fit"], {"experiment": {"0": {"data": "(absent)"}, "1": "(absent)"}})
    names = fault["text"].partition("\n")[0].replace(";", ",").split(",")
    columns = dict(zip(("time", "value"), names, strict=False)) if len(names) > 1 else {}
    data = {"quantity": "penetration", "sd": 0.2, "columns": columns, **fault.get("data", {})}
    tables["experiment"][0]["data"] = [{**data, "file": str(folder / "z.csv")}]
    rw.fit(tables)


def inputs(fault, folder):
    (folder / "m.csv").write_text(fault["text"])
    columns = dict(zip(("time", "value"), fault["text"].partition("\n")[0].split(";"), strict=True))
    torque = {"key": "contact.friction", "quantity": "torque", "columns": columns}
    given = {"experiment": {"0": {"input": [{**torque, "file": str(folder / "m.csv")}]}}}
    rw.design(merged(merged(BASES["fit"], given), fault.get("set", {})))


def laboratory(fault, folder):
    (folder / "tests.csv").write_text(BASES["table"]["text"], encoding="utf-8")
    edited(folder / "tests.csv", fault.get("edit", ["", ""]))
    tables = merged(BASES["fit"], {**BASES["tests"]})
    tables["tests"]["file"] = str(folder / "tests.csv")
    rw.fit(merged(tables, fault.get("set", {})))


def measure(fault, folder):
    shutil.copytree(ROOT / "scripts/measure", folder, dirs_exist_ok=True)
    edited(folder / fault.get("file", "measure.toml"), fault["edit"])
    rw.measure(folder / "measure.toml")


def function(fault, folder):
    keys = ["wear.lower.k", "load.pressure"]
    inputs, outputs = fault.get("inputs", keys), fault.get("outputs", ["torque"])
    case = rw.read_case(PAPER, {"time.steps": 20})
    rw.function(case, inputs, outputs, derivatives="derivatives" in fault)(fault.get("values", {}))


READERS = {
    reader.__name__: reader
    for reader in (case, study, fit, readings, inputs, laboratory, measure, function)
}


def name_of(value):
    return value if isinstance(value, str) else "-".join([value.get("loc", ""), *value["words"]])


@pytest.mark.parametrize(("kind", "fault"), ALL, ids=name_of)
def test_fault(kind, fault, tmp_path, monkeypatch):
    monkeypatch.chdir(FIT)  # files of fits are named from there
    with pytest.raises(rw.InputError) as caught:
        READERS[kind](fault, tmp_path)
    assert caught.value.exit_status == 2
    faults = pickle.loads(pickle.dumps(caught.value)).faults  # as from another rank
    usual = {"readings": "experiment.data.file", "laboratory": "tests.file"}.get(kind, "")
    loc, code = fault.get("loc", usual), fault.get("code", "invalid")
    (told, *_) = [f for f in faults if (f.loc, f.code) == (loc, code)] or [None]
    assert told, [(f.loc, f.code, str(f)) for f in faults]
    assert all(word in told for word in fault["words"]), told
    assert len(faults) == fault.get("number", 1)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    rw.simulate(rw.read_case(PAPER, {"time.steps": 2})).save(folder / "run.h5")
    return folder


@pytest.mark.parametrize("fault", COMMANDS, ids=lambda fault: fault["line"])
def test_line(fault, results, monkeypatch, capsys):
    monkeypatch.chdir(results)
    assert main(fault["line"].split()) == 2
    (sentence,) = capsys.readouterr().err.splitlines()
    assert sentence.startswith("ringwear: ")
    assert all(word in sentence for word in fault["words"]), sentence
    assert [path.name for path in results.iterdir()] == ["run.h5"]


@pytest.mark.parametrize(
    ("command", "source", "edit"),
    [
        ("run", CASES / "paper.toml", ["young = 10e3", "young = -1"]),
        ("sweep", CASES / "study.toml", ["p0", "q0"]),
        ("fit", FIT / "fit.toml", ["start", "begin"]),
        ("measure", ROOT / "scripts/measure/measure.toml", ["W1.csv", "W9.csv"]),
    ],
)
def test_the_command_says_it_and_writes_nothing(command, source, edit, tmp_path, capsys):
    folder = shutil.copytree(source.parent.parent, tmp_path / "scripts") / source.parent.name
    edited(folder / source.name, edit)
    out = tmp_path / ("out.h5" if command == "run" else "out")
    assert main([command, str(folder / source.name), "-o", str(out)]) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    assert errors
    assert all(line.startswith("ringwear: ") for line in errors.splitlines())
    assert not out.exists()
