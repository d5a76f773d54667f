from collections.abc import Sequence

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.elasticity.bem.boundary import BoundaryMesh
from ringwear_par.elasticity.bem.quadrature import Quadrature
from ringwear_par.elasticity.bem.systems import BoundaryConditions, DofMap

def moments(r: float, a: float, b: float) -> tuple[float, ...]: ...
def ring_kernels(points: FloatArray, poisson: float) -> FloatArray: ...
def stress_kernels(points: FloatArray, poisson: float) -> FloatArray: ...
def assemble_rows(
    first_node: int,
    last_node: int,
    boundary: BoundaryMesh,
    conditions: BoundaryConditions,
    dofs: DofMap,
    young: float,
    poisson: float,
    rules: Quadrature,
    starts: Sequence[int] | IntArray,
    widths: Sequence[int] | IntArray,
    normal: FloatArray,
    torsion: FloatArray,
) -> int: ...
def stress_rows(
    points: FloatArray,
    nearest: IntArray,
    boundary: BoundaryMesh,
    poisson: float,
    rules: Quadrature,
    normal: FloatArray,
    torsion: FloatArray,
) -> int: ...
