"""What messages show of texts that are too long, or that nobody would see."""

import pytest
from parts import legible
from paths import PAPER

import ringwear_par as rw


def test_messages_are_short_and_on_one_line():
    assert legible("a" * 72) == "a" * 72
    assert len(legible("a" * 73)) == 72
    assert legible("\x1b[2J\u202e\ud800\n") == r"\x1b[2J\u202e\ud800\n"
    for text in ("\n" * 60, "\0" * 10_000, "\N{LATIN SMALL LETTER E WITH ACUTE}" * 500):
        assert legible(legible(text)) == legible(text)
    assert str(rw.ComputationError("two\nlines")) == r"two\nlines"
    assert len(str(rw.InputError("x" * 5000))) == 1000
    with pytest.raises(rw.InputError, match=r"lower\.young") as caught:
        rw.read_case(PAPER, {"lower.young": "x" * 100_000})
    assert len(str(caught.value)) < 300
