import numpy as np
from numpy.typing import NDArray

from ringwear_par.arrays import FloatArray
from ringwear_par.contact.problem import Compliance

def solve(
    compliance: Compliance,
    gap: FloatArray,
    load: FloatArray,
    by_force: bool,
    konst: FloatArray,
    slope: FloatArray,
    relative: float,
    depth: FloatArray,
    p: FloatArray,
    d: FloatArray,
    sets: NDArray[np.int32],
) -> None: ...
def respond(
    compliance: Compliance,
    by_force: bool,
    inverse: FloatArray,
    slope: FloatArray,
    share: float,
    g: FloatArray,
    x: FloatArray,
) -> None: ...
