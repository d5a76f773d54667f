from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.elasticity.bem.boundary import BoundaryMesh
from ringwear_par.elasticity.bem.quadrature import Quadrature

def kernels(points: FloatArray, poisson: float, stress: bool = False) -> FloatArray: ...
def integrate_rows(
    sources: FloatArray,
    nodes: IntArray,
    boundary: BoundaryMesh,
    poisson: float,
    rules: Quadrature,
    columns: IntArray,
    factors: FloatArray,
    rows: IntArray,
    matrix: FloatArray,
) -> FloatArray: ...
