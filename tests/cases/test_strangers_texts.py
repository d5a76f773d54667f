"""What messages show of texts that are too long, or that nobody would see."""

import json
import pickle

import pytest
from paths import CASES, PAPER

from ringwear_par import InputError, read_case, read_study
from ringwear_par.errors import ComputationError, legible


def test_messages_are_short_and_on_one_line():
    assert legible("a" * 72) == "a" * 72
    assert len(legible("a" * 73)) == 72
    assert legible("\x1b[2J\u202e\ud800\n") == r"\x1b[2J\u202e\ud800\n"
    for text in ("\n" * 60, "\0" * 10_000, "\N{LATIN SMALL LETTER E WITH ACUTE}" * 500):
        assert legible(legible(text)) == legible(text)
    assert str(ComputationError("two\nlines")) == r"two\nlines"
    assert len(str(InputError("x" * 5000))) == 1000
    with pytest.raises(InputError, match=r"x{40,} \.\.\. x+\": must be") as caught:
        read_case(PAPER, {"lower.young": "x" * 100_000})
    assert len(str(caught.value)) < 300


def test_faults_that_are_raised_again_keep_their_number():
    """Every command raises those of a file on all ranks."""
    first = InputError(*(f"fault {number}" for number in range(1000)))
    assert first.faults[-1] == "and 900 faults more"
    assert InputError(*first.faults).faults == first.faults
    assert pickle.loads(pickle.dumps(first)).faults == first.faults


@pytest.mark.parametrize("name", ["k 1", "1k", "k-1", "", "k.1", "k\x1b"])
def test_names_of_parameters_are_identifiers(tmp_path, name):
    """A sweep lists its varied keys with blanks between them."""
    with pytest.raises(InputError, match=r"wear\.lower\.parameters"):
        read_case(CASES / "user_law.toml", {"wear.lower.parameters": {name: 1.0}})
    written = json.dumps(f"wear.lower.parameters.{name}", ensure_ascii=True)
    path = tmp_path / "study.toml"
    path.write_text(f'case = "{CASES}/user_law.toml"\n[vary]\n{written} = {{ values = [1.0] }}\n')
    with pytest.raises(InputError, match=r"wear\.lower\.parameters"):
        read_study(path)
