"""Laws of a case: the key that names one, what laws declare, what is tried before a run."""

from dataclasses import dataclass, fields, replace

import pytest
from paths import PAPER

from ringwear_par.cases.files.reading import read_case
from ringwear_par.cases.schema import BY_PATH, KEYS
from ringwear_par.cases.tables import key_table
from ringwear_par.errors import InputError
from ringwear_par.wear.law import parameters_of
from ringwear_par.wear.laws import LAWS
from ringwear_par.wear.laws.running_in import RunningInLaw

TEXT = PAPER.read_text()


@pytest.mark.parametrize("parameter", ["k", "p0"])
def test_no_law_is_meant_silently(parameter):
    with pytest.raises(InputError, match=r"wear\.upper\.law is missing") as caught:
        read_case(PAPER, {f"wear.upper.{parameter}": 1e-8})
    assert len(caught.value.faults) == 1
    case = read_case(PAPER, {"wear.upper": {"law": "archard", "k": 1e-9}})
    assert case.wear_upper == LAWS["archard"](1e-9)


def test_keys_are_what_the_laws_declare():
    text = key_table(KEYS)
    for name, law in LAWS.items():
        declared = parameters_of(law)
        assert declared
        for parameter in declared.values():
            key = BY_PATH[f"wear.lower.{parameter.name}"]
            assert parameter.meaning in key.meaning
            assert parameter.unit in (key.unit, "mm/s")
            assert key.default == (None if parameter.default in (..., ()) else parameter.default)
        assert law.formula in BY_PATH["wear.lower.law"].meaning, name
        known = {f.name for f in fields(law)}
        assert known - set(declared) <= {"source"}  # of a user's file, which is a key
    assert "required" not in "".join(line for line in text.splitlines() if "wear." in line)


def test_a_case_takes_a_law_with_a_rate_alone():
    @dataclass(frozen=True)
    class Mine:
        k: float

        def rate(self, p, local):
            return self.k * local.speed * p

    case = replace(read_case(PAPER), wear_lower=Mine(1e-8))
    lower, upper = case.laws
    assert (lower.user_object, upper) == (Mine(1e-8), None)
    assert lower.describe() == "Mine.rate(p, local) with k = 1e-08"
    assert case.breakpoints == ()


def test_numbers_of_running_in_from_python_are_refused_as_those_of_files():
    RunningInLaw(k=2e-7, k_start=2e-7, depth=1.0)
    with pytest.raises(InputError, match=r"^k_start = 1e-07: must be at least k = 2e-07$"):
        RunningInLaw(k=2e-7, k_start=1e-7, depth=1.0)
