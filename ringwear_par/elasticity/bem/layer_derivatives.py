"""What numbers of a layer do to the compliance of its body, by differences of two assemblies."""

from dataclasses import dataclass, replace
from typing import Literal

from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.bem.body import Compliance, compliance
from ringwear_par.elasticity.bem.boundary import count_elements
from ringwear_par.elasticity.geometry.mesh import ContactLine, Mesh
from ringwear_par.elasticity.geometry.sections import Body

#: numbers of a layer
Entry = Literal["thickness", "young", "poisson"]
#: share of a number by which it is varied; integrals change their rules with a thickness
_SHARES: dict[Entry, float] = {"thickness": 1e-3, "young": 1e-4, "poisson": 1e-4}


@dataclass(frozen=True)
class ComplianceChange:
    """Derivatives of a body's compliance at Young's modulus 1 with respect to a number.

    Parameters
    ----------
    normal : (n, n) float, mm/MPa over the unit of the number.
    twist : (n,) float, mm^3/MPa over that unit, of the area integral of ``torsion``.
    """

    normal: FloatArray
    twist: FloatArray


def layer_derivative(
    body: Body,
    layer: int,
    entry: Entry,
    line: ContactLine,
    mesh: Mesh,
    slope: FloatArray,
    comm: MPI.Comm,
) -> ComplianceChange:
    """Return what a number of a layer does to its body. Collective on comm.

    Parameters
    ----------
    layer : its number, from the contact face downwards.
    entry : the thickness, mm, or of its material the modulus over that of the body itself, or
        Poisson's ratio.
    line, mesh, slope : as of ``compliance``.

    Raises
    ------
    ComputationError : a factorisation failed.
    """
    contact = float(line.edges[0]), float(line.edges[-1])
    count = count_elements(body.section, contact, mesh)
    found: list[tuple[float, Compliance]] = []
    for share in (-_SHARES[entry], _SHARES[entry]):
        varied, by = _varied(body, layer, entry, share)
        # a mesh that jumps would be no difference of the same thing
        if count_elements(varied.section, contact, mesh) == count:
            found.append((by, compliance(varied, line, mesh, comm, slope=slope)))
    if len(found) == 1:
        found.append((0.0, compliance(body, line, mesh, comm, slope=slope)))
    (low, before), (high, after) = found
    normal, torsion = after.normal - before.normal, after.torsion - before.torsion
    return ComplianceChange(normal / (high - low), line.area @ torsion / (high - low))


def _varied(body: Body, layer: int, entry: Entry, share: float) -> tuple[Body, float]:
    """Return a body of which a number is larger by a share of it, and by how much that is."""
    if entry == "thickness":
        thickness = list(body.section.layers)
        by = share * thickness[layer]
        thickness[layer] += by
        return replace(body, section=replace(body.section, layers=tuple(thickness))), by
    materials = list(body.layers)
    number = getattr(materials[layer], entry)
    # Poisson's ratio may be 0
    by = share * number if entry == "young" else share
    materials[layer] = replace(materials[layer], **{entry: number + by})
    return replace(body, layers=tuple(materials)), by / body.young if entry == "young" else by
