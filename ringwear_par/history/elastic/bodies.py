"""The elastic bodies of a case."""

from collections.abc import Hashable

from ringwear_par.cases.case import Case
from ringwear_par.elasticity.mesh import pair_key
from ringwear_par.elasticity.sections import Body, Material


def bodies(case: Case) -> tuple[Body, Body]:
    """Return lower and upper. Not collective."""
    lower, upper = (
        Body(
            case.section(ring), ring.young, ring.poisson, ring.grip,
            tuple(Material(layer.young, layer.poisson) for layer in ring.layers),
        )
        for ring in case.rings
    )  # fmt: skip
    return lower, upper


def young(case: Case) -> tuple[float, float]:
    """Return Young's moduli of lower and upper, MPa. Not collective."""
    return case.lower.young, case.upper.young


def operator_key(case: Case) -> Hashable:
    """Return the key of the contact pair of a case; equal for cases that can share it."""
    return pair_key(bodies(case), case.contact, case.mesh)
