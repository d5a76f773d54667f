"""What a case may not ask of a number of ranks."""

from ringwear_par.cases.case import Case
from ringwear_par.contact.solver import REPLICATED_LIMIT
from ringwear_par.errors import InputError


def check_ranks(case: Case, ranks: int, name: str) -> None:
    """Refuse a non-local law in a contact problem that ranks would share. Not collective.

    Parameters
    ----------
    ranks : of the case.
    name : what messages call the case.

    Raises
    ------
    InputError : one sentence a body.
    """
    elements = case.mesh.contact_elements
    if ranks == 1 or elements <= REPLICATED_LIMIT:
        return
    faults = [
        f"{name}: mesh.contact_elements = {elements}: must be at most {REPLICATED_LIMIT} on "
        f"several ranks where wear.{body}.law averages over a length"
        for body, law in zip(("lower", "upper"), case.laws, strict=True)
        if law is not None and law.length
    ]
    if faults:
        raise InputError(*faults)
