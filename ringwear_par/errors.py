"""The two ways a command can fail, with their exit statuses; warnings; how messages show texts."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

#: longest value, key or word of a user, and longest sentence that messages show in full
_LONGEST_VALUE, LONGEST_SENTENCE = 72, 1000
#: faults of one input that are listed one by one; of more, only their number
MOST_FAULTS = 100


def legible(text: str, most: int = _LONGEST_VALUE) -> str:
    """Return a text as messages show it: on one line, escaped where it would not be seen.

    The middle of a long one is left out.
    """
    text = _cut(text, most)
    if text.isprintable():
        return text
    seen = (c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return _cut("".join(seen), most)


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, as messages have it."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _cut(text: str, most: int) -> str:
    if len(text) <= most:
        return text
    tail = (most - 5) // 4
    return f"{text[: most - 5 - tail]} ... {text[-tail:]}"


@dataclass(frozen=True)
class ValidityWarning:
    """A reason why numbers may not be valid, though they were computed."""

    #: a short name, of letters, underscores and hyphens, of warnings of this kind
    code: str
    #: the whole sentence
    text: str
    #: of the numbers that may be wrong, or that it is about; () for none
    keys: tuple[str, ...] = ()
    #: of a fit, that it is of; () for all
    experiments: tuple[str, ...] = ()
    #: numbers of the sentence, by name
    values: dict[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return its fields, as JSON files have them."""
        return asdict(self)

    @classmethod
    def of(cls, entry: Mapping[str, Any]) -> "ValidityWarning":
        """Return the warning with these fields, see ``to_dict``."""
        keys, experiments = (tuple(entry[name]) for name in ("keys", "experiments"))
        return cls(entry["code"], entry["text"], keys, experiments, dict(entry["values"]))


def warning_lines(sentences: Iterable[str]) -> list[str]:
    """Return the lines of a summary that warn."""
    return [f"warning: {sentence}" for sentence in sentences]


class RingwearError(Exception):
    """A failure that the user reads in one sentence; exit status 1."""

    exit_status = 1
    #: how many ranks raise it alike, as far as it is known
    ranks = 0

    def __init__(self, sentence: str = "") -> None:
        super().__init__(legible(sentence, LONGEST_SENTENCE))


class ComputationError(RingwearError):
    """A computation that did not succeed: which case, step and residual."""


def reason_of(error: Exception) -> str:
    """Return why something failed, as it is stored: on one line."""
    reason = str(error) if isinstance(error, RingwearError) else repr(error)
    return _cut(" ".join(reason.split()), LONGEST_SENTENCE)


class LawError(ComputationError):
    """A user's wear law that failed; no other step will do."""


#: kinds of fault: "not_allowed" is a value that is wrong by itself, "conflict" are keys that do not
#: go together, "unreadable" is a file, "not_found" a column of one; "invalid": another
Code = Literal[
    "unknown_key", "missing", "not_allowed", "conflict", "unit", "unreadable", "not_found",
    "invalid",
]  # fmt: skip


class Fault(str):
    """The sentence of one fault: the file, the key, the value and what is allowed.

    Attributes
    ----------
    loc : the dotted key, as ``info --schema`` lists it; "" where it is of no one key.
    code : the kind of fault.
    """

    loc: str
    code: Code

    def __new__(cls, sentence: str, loc: str = "", code: Code | None = None) -> "Fault":
        """Return a fault; a sentence that is one keeps what is not given."""
        fault = super().__new__(cls, sentence)
        fault.loc = loc or (sentence.loc if isinstance(sentence, Fault) else "")
        fault.code = code or (sentence.code if isinstance(sentence, Fault) else "invalid")
        return fault

    def reworded(self, sentence: str) -> "Fault":
        """Return the same fault in other words."""
        return Fault(sentence, self.loc, self.code)

    def __reduce__(self) -> tuple[type["Fault"], tuple[str, str, str]]:
        return Fault, (str(self), self.loc, self.code)


class InputError(RingwearError):
    """Bad input: one sentence a fault, all faults of a file together; exit status 2.

    Parameters
    ----------
    *faults : the sentences, see ``Fault``.
    """

    exit_status = 2

    def __init__(self, *faults: str) -> None:
        more = len(faults) - MOST_FAULTS
        if more > 1:  # one more than that is the sentence that there are more
            faults = (*faults[:MOST_FAULTS], f"and {more} faults more")
        self.faults = tuple(
            Fault(fault).reworded(legible(fault, LONGEST_SENTENCE)) for fault in faults
        )
        Exception.__init__(self, "\n".join(self.faults))

    def __reduce__(self) -> tuple[type["InputError"], tuple[Fault, ...]]:
        return type(self), self.faults


class UnfitError(InputError):
    """A case whose own numbers do not go together, as only its first solution tells."""
