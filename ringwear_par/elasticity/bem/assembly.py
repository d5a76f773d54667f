"""Assembly of the boundary equation (5) of a body, on the rank that owns its rows.

The traction kernel acts on u(y) - u*(y), where u* is the rigid or constant-strain field that agrees
with u at the collocation point, so every integrand is bounded.
"""

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI

from ringwear_par.elasticity._rings import assemble_rows
from ringwear_par.elasticity.bem.quadrature import Quadrature
from ringwear_par.elasticity.bem.systems import (
    SYSTEMS,
    Assembly,
    DofMap,
    Rows,
    Zone,
)
from ringwear_par.errors import ComputationError
from ringwear_par.parallel import together

#: why integrals over boundary elements are refused
TOO_CLOSE = (
    "boundary elements lie too close to each other, or are too long for it, to be integrated over: "
    "thicker layers or bodies, or a milder mesh.grading, are needed"
)


def assemble(
    zones: Sequence[Zone],
    dofs: Sequence[DofMap],
    rules: Quadrature,
    comm: MPI.Comm,
) -> Assembly:
    """Assemble this rank's rows of both systems at modulus 1 of the body itself.

    Collective on comm. Nodes of all zones are shared out in equal runs, so a rank holds about
    1/size of the rows and no rank holds a whole matrix.

    Parameters
    ----------
    dofs : of ``number_dofs``, one a zone.

    Raises
    ------
    ComputationError : a node too close to an element that it does not belong to.
    """
    first = np.cumsum([0, *(len(zone.boundary.nodes) for zone in zones)])
    begin, end = (rank * int(first[-1]) // comm.size for rank in (comm.rank, comm.rank + 1))
    # number of the first row of each node in the (r, z) and in the theta system
    equations = np.concatenate([zone.equation for zone in dofs])
    counts = np.stack([(equations[:, block] >= 0).sum(axis=1) for block in SYSTEMS])
    row = np.concatenate([np.zeros((2, 1), dtype=np.int64), np.cumsum(counts, axis=1)], axis=1)
    heights, widths, n_loads = row[:, end] - row[:, begin], row[:, -1], zones[0].conditions.n_loads
    # column-major, the loads behind the last unknown
    arrays = [
        np.zeros((height, width + n_loads), order="F")
        for height, width in zip(heights, widths, strict=True)
    ]
    normal, torsion = (
        Rows(array[:, :width], array[:, width:], int(start), tuple(zone_starts.tolist()))
        for array, width, start, zone_starts in zip(
            arrays, widths, row[:, begin], row[:, first[:-1]], strict=True
        )
    )
    evaluations = 0
    with together(comm):
        for zone, numbers, start, stop in zip(
            zones, dofs, first[:-1].tolist(), first[1:].tolist(), strict=True
        ):
            if max(begin, start) >= min(end, stop):
                continue
            done = assemble_rows(
                max(begin, start) - start, min(end, stop) - start, zone.boundary, zone.conditions,
                numbers, zone.material.young, zone.material.poisson, rules, row[:, begin], widths,
                arrays[0].T, arrays[1].T,
            )  # fmt: skip
            if done < 0:
                raise ComputationError(TOO_CLOSE)
            evaluations += done
    return Assembly(normal, torsion, evaluations)
