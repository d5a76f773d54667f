"""Texts of strangers: too long, too deep, unseen; refused in a sentence that can be read."""

import difflib
import json
import os
import pickle

import numpy as np
import pytest
from paths import CASES, PAPER

from ringwear_par import read_case, read_study
from ringwear_par.cases.files import key_values
from ringwear_par.cases.files.reading import parse_case
from ringwear_par.errors import ComputationError, InputError, legible

TEXT = PAPER.read_text()
USER = (CASES / "user_law.toml").read_text()
DEEP = "[" * 2000 + "]" * 2000
HUGE = "0x" + "f" * 5000


def refusal(read, *args):
    with pytest.raises(InputError) as caught:
        read(*args)
    for fault in caught.value.faults:
        assert fault.isprintable()
        assert len(fault) <= 1000
    return str(caught.value)


def with_value(key, value):
    before, after = TEXT.split(f"{key} = ", 1)
    return f"{before}{key} = {value}\n{after.partition(chr(10))[2]}"


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("1" * 5000, "is not valid TOML"),
        ("1" * 600, f"young = {'1' * 51} ... {'1' * 16}: must be a finite number"),
        (HUGE, f"young = 0x{'f' * 49} ... {'f' * 16}: must be a finite number"),
        (DEEP, "nested in each other too deeply; must be at most 32 deep"),
        ("[" * 100 + "]" * 100, "nested in each other too deeply; must be at most 32 deep"),
        ("[" * 20 + "]" * 20, f"young = {'[' * 20}{']' * 20}: must be a finite number"),
        ('"' + "x" * 100_000 + '"', f'young = "{"x" * 50} ... {"x" * 15}": must be a finite'),
        ('"\\u202e\\u001b[2J"', r'young = "\u202e\u001b[2J": must be a finite number'),
    ],
)
def test_a_value_that_is_none(value, said):
    assert said in refusal(parse_case, with_value("young", value), "case.toml")


def test_keys_too_deep_and_too_long():
    deep = ".".join("a" * 1500) + " = 1\n"
    assert "too deeply" in refusal(parse_case, deep + TEXT, "case.toml")
    told = refusal(parse_case, f"{'k' * 90_000} = 1\n" + TEXT, "case.toml")
    assert told == f"case.toml: {'k' * 51} ... {'k' * 16}: unknown key"
    many = "".join(f"k{n} = 1\n" for n in range(1000))
    told = refusal(parse_case, many + TEXT, "case.toml").splitlines()
    assert len(told) == 101
    assert told[-1] == "and 900 faults more"


def test_faults_that_are_raised_again_keep_their_number():
    """Every command raises those of a file on all ranks."""
    first = InputError(*(f"fault {number}" for number in range(1000)))
    assert first.faults[-1] == "and 900 faults more"
    assert InputError(*first.faults).faults == first.faults
    assert pickle.loads(pickle.dumps(first)).faults == first.faults


@pytest.mark.parametrize("source", ["law", "override"])
def test_a_zero_byte_in_a_name(source, tmp_path):
    text = USER.replace('"user_law.py"', '"user\\u0000law.py"')
    assert text != USER
    if source == "law":
        (tmp_path / "case.toml").write_text(text)
        told = refusal(read_case, tmp_path / "case.toml")
    else:
        told = refusal(read_case, CASES / "user_law.toml", {"wear.lower.file": "user\0law.py"})
    assert "wear.lower.file" in told
    refusal(read_case, "case\0.toml")


def test_a_dict_that_holds_itself():
    tables = {"lower": {}}
    tables["lower"]["young"] = [tables]
    assert "too deeply" in refusal(read_case, tables)
    assert "too deeply" in refusal(read_study, {"case": tables, "vary": {}})


@pytest.mark.parametrize("name", ["k 1", "1k", "k-1", "", "k.1", "k\x1b"])
def test_names_of_parameters_are_identifiers(tmp_path, name):
    """A sweep lists its varied keys with blanks between them."""
    said = refusal(read_case, CASES / "user_law.toml", {"wear.lower.parameters": {name: 1.0}})
    assert "wear.lower.parameters" in said
    assert f'"{legible(name)}": names must be of letters, digits and _' in said
    written = json.dumps(f"wear.lower.parameters.{name}", ensure_ascii=True)
    path = tmp_path / "study.toml"
    path.write_text(f'case = "{CASES}/user_law.toml"\n[vary]\n{written} = {{ values = [1.0] }}\n')
    assert "wear.lower.parameters" in refusal(read_study, path)


def study(folder, text, table=""):
    (folder / "paper.toml").write_text(TEXT)
    (folder / "study.toml").write_text('case = "paper.toml"\n' + text)
    (folder / "table.csv").write_text(table)
    return folder / "study.toml"


LISTED = '[design]\nmethod = "list"\nfile = "table.csv"\n'


@pytest.mark.parametrize(
    ("text", "table", "said"),
    [
        (f"x = {DEEP}\n", "", "too deeply"),
        (LISTED.replace("table.csv", "a\\u0000b"), "", "no zero bytes"),
        (LISTED, "load.pressure\n" + "1" * 200_000, "is not a table of comma-separated values: f"),
        (LISTED, "load.pressure\n" + "1" * 5000, "load.pressure = "),
        (LISTED, "load.pressure\n" + DEEP, "load.pressure = "),
        (LISTED, "wear.lower.k;load.pressure\n1,5e-7;50\n", "separated by commas, not ;"),
        (LISTED, "x" * 1000 + "\n1", f"column {'x' * 51} ... {'x' * 16}: unknown key"),
        (
            '[vary]\n"load.pressure" = { linear = [1, 2], count = 100000000000000000000 }\n', "",
            "count = 100000000000000000000: must be a whole number from 2 to 10000000 in a grid",
        ),
        ('[vary]\n"load.pressure" = 0x' + "f" * 3000, "", '"load.pressure" = 0xfff'),
        (f'[vary]\n"wear.lower.k" = {{ values = [{HUGE}, 1] }}\n', "", "case 1: wear.lower.k = 0x"),
        (f'[vary]\n"time.scheme" = {{ values = [[{HUGE}], 1] }}\n', "", "time.scheme = [0xfff"),
        (
            "[vary]\n" + "".join(
                f'"{key}" = {{ linear = [1, 2], count = 9999999 }}\n'
                for key in ("load.pressure", "load.omega", "lower.young")
            ), "", "must be at most 10000000",
        ),
    ],
)  # fmt: skip
def test_a_study_that_is_none(tmp_path, text, table, said):
    assert said in refusal(read_study, study(tmp_path, text, table))


def test_what_messages_show():
    assert legible("a" * 72) == "a" * 72
    assert len(legible("a" * 73)) == 72
    assert legible("\x1b[2J\u202e\ud800\n") == r"\x1b[2J\u202e\ud800\n"
    for text in ("\n" * 60, "\0" * 10_000, "é" * 500):
        assert legible(legible(text)) == legible(text)
    assert str(ComputationError("two\nlines")) == r"two\nlines"
    fault = str(InputError("x" * 5000))
    assert len(fault) == 1000
    assert InputError(fault).faults == (fault,)
    assert "nan" in refusal(read_case, PAPER, {"lower.young": np.float64("nan")})


def test_nobody_looks_for_what_is_meant_by_keys_that_are_not_told(tmp_path, monkeypatch):
    """Each look compares a key with all that there are."""
    looks, near = [], difflib.get_close_matches

    def counted(*words, **more):
        looks.append(words)
        return near(*words, **more)

    monkeypatch.setattr(key_values.difflib, "get_close_matches", counted)
    keys = [f"key{i}" for i in range(3000)]
    told = refusal(parse_case, "\n".join(f"{k} = 1" for k in keys) + f"\n{TEXT}", "case.toml")
    assert told.splitlines()[-1] == "and 2900 faults more"
    (tmp_path / "paper.toml").write_text(TEXT)
    study = tmp_path / "study.toml"
    vary = "\n".join(f'"{k}" = {{ values = [1] }}' for k in keys)
    study.write_text(f'case = "paper.toml"\n[vary]\n{vary}\n')
    assert refusal(read_study, study).splitlines()[-1] == "and 2900 faults more"
    (tmp_path / "table.csv").write_text(f"{','.join(keys)}\n{','.join('1' for _ in keys)}\n")
    study.write_text(f'case = "paper.toml"\n{LISTED}')
    assert refusal(read_study, study).splitlines()[0].endswith("column key0: unknown key")
    assert len(looks) < 2500


@pytest.mark.parametrize("kind", ["case", "law", "profile", "study", "list", "base"])
@pytest.mark.parametrize("what", ["pipe", "device"])
def test_pipes_and_devices_are_refused(tmp_path, kind, what):
    """The one would keep us waiting, the other has no end."""
    odd = tmp_path / "odd"
    if what == "pipe":
        os.mkfifo(odd)
    else:
        odd.symlink_to("/dev/zero")
    (tmp_path / "paper.toml").write_text(TEXT)
    study = tmp_path / "study.toml"
    changes = {
        "law": {"wear.lower": {"law": "user", "file": str(odd)}},
        "profile": {"upper.profile": {"file": str(odd)}},
    }
    if kind in changes:
        told = refusal(read_case, tmp_path / "paper.toml", changes[kind])
    elif kind == "case":
        told = refusal(read_case, odd)
    else:
        study.write_text(
            'case = "paper.toml"\n' + LISTED.replace("table.csv", "odd")
            if kind == "list"
            else 'case = "odd"\n[vary]\n"load.pressure" = { values = [1] }\n'
        )
        told = refusal(read_study, odd if kind == "study" else study)
    assert ": cannot be read: it is a pipe or a device, must be an ordinary file" in told
