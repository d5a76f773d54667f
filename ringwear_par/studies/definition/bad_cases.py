"""Bad cases of a study, told: the same sentence once, with the cases that it is of."""

from collections.abc import Sequence

#: bad cases that are looked at; those of them whose own sentences are told
LOOKED_AT, _TOLD = 200, 5
#: so many cases of a sentence are named, or one more
_NAMED = 3


def case_name(study: str, number: int) -> str:
    """Return what messages call a case of a study; the first one has number 1."""
    return f"{study}: case {number}"


def told_faults(
    study: str, found: Sequence[tuple[int, Sequence[str]]], bad: int, count: int
) -> list[str]:
    """Return the faults of bad cases, and how many more there are.

    Parameters
    ----------
    study : what messages call it.
    found : numbers and faults of the first bad cases; these begin with the ``case_name``.
    bad, count : number of bad cases, and of all.
    """
    cases_of: dict[str, list[int]] = {}
    first = told = 0
    for number, faults in found:
        named = f"{case_name(study, number)}: "
        sentences = dict.fromkeys(fault.removeprefix(named) for fault in faults)
        if not sentences.keys() <= cases_of.keys():
            if first == _TOLD:
                continue
            first += 1
        told += 1
        for sentence in sentences:
            cases_of.setdefault(sentence, []).append(number)
    lines = [f"{study}: {_told(cases)}: {sentence}" for sentence, cases in cases_of.items()]
    if bad > told:
        lines.append(f"{study}: {bad - told} more of {count} cases are bad")
    return lines


def _told(cases: Sequence[int]) -> str:
    """Name cases, the first of them where they are many."""
    if len(cases) == 1:
        return f"case {cases[0]}"
    many = len(cases) > _NAMED + 1
    named = cases[:_NAMED] if many else cases[:-1]
    last = f"{len(cases) - _NAMED} others" if many else str(cases[-1])
    return f"cases {', '.join(map(str, named))} and {last}"
