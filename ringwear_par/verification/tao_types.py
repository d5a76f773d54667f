"""Contact by our own method against contact by those of PETSc's TAO, of the same problem."""

from collections.abc import Iterator

import numpy as np
from mpi4py import MPI

from ringwear_par.contact.engine import TAO_TYPES, ContactEngine
from ringwear_par.contact.problem import ContactState
from ringwear_par.elasticity.geometry.mesh import Mesh
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.physics import Physics
from ringwear_par.verification.check import Check
from ringwear_par.verification.paper import OMEGA, paper_case

_N = 64
#: s of wear in the step, and heights of the roughness, mm
_STEP, _HEIGHTS = 20.0, (0.0, 0.01, 0.05)


def tao_checks(comm: MPI.Comm) -> Iterator[Check]:
    """Compare pressures of the paper's rings, smooth and rough, after a step. Collective on comm.

    Some elements are apart, some below the threshold of wear, some above.
    """
    case = paper_case(Mesh(_N))
    physics = Physics.of([case] * len(_HEIGHTS), assemble(case, comm))
    roughness = np.multiply.outer(_HEIGHTS, np.random.default_rng(1).random(_N))
    every, unworn = np.ones(len(_HEIGHTS)), np.zeros((2, len(_HEIGHTS), _N))
    increment = physics.increment(_STEP * every, OMEGA * every, unworn, _STEP * every)
    inputs = physics.contact_inputs(_STEP * every, unworn, increment)

    def solution(tao_type: str) -> ContactState:
        compliances = physics.compliances.scaled()
        with ContactEngine(compliances, physics.compliances.which, tao_type) as engine:
            return engine.solve(inputs.gap + roughness, force=inputs.force, wear=inputs.wear)

    ours, *by_petsc = map(solution, TAO_TYPES)
    largest = ours.pressure.max(axis=1, keepdims=True)
    for tao_type, other in zip(TAO_TYPES[1:], by_petsc, strict=True):
        error = float((np.abs(other.pressure - ours.pressure) / largest).max())
        yield Check(f"contact with wear by TAO's {tao_type}: pressure", (_N,), (error,), 1e-8)
