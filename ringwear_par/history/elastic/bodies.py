"""The elastic bodies of a case."""

from collections.abc import Hashable

from ringwear_par.cases.case import Case
from ringwear_par.contact.problem import LARGEST_WITH_BASES
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


def shares_reference(case: Case) -> bool:
    """Tell whether the compliance of a case is one of a family, and not a reference itself.

    It is where a modulus has more than four digits: moduli that a user writes have a reference
    each, which serves all cases of a sweep; those that a design draws or a fit tries share one. The
    answer depends on the case alone, so that its digits do.
    """
    plain = all(float(f"{modulus:.3e}") == modulus for modulus in young(case))
    return not plain and may_share_reference(case)


def may_share_reference(case: Case) -> bool:
    """Tell whether compliances of about the moduli of a case share a reference: are in families.

    Not in a family are bodies with layers and elements that follow the wear, whose compliances are
    their own anyway, and large systems, which have no bases to share.
    """
    alone = case.follows_wear or any(ring.layers for ring in case.rings)
    return not alone and case.mesh.contact_elements <= LARGEST_WITH_BASES


def operator_key(case: Case) -> Hashable:
    """Return the key of the contact pair of a case; equal for cases that can share it."""
    return pair_key(bodies(case), case.contact, case.mesh)
