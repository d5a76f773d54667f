"""Contact problems: random ones on random faces, beds of springs, pairs that are hard to solve."""

from dataclasses import dataclass, replace

import numpy as np
from parts import Line, Material, ThresholdLaw

from ringwear_par.contact.problem import Compliance
from ringwear_par.elasticity.sections import Body, Section
from ringwear_par.history.block import Block


def drawn(paper, count, seed, law=None, by_force=True):
    """Return a block of random moduli and wear on random faces, and its contact problems.

    Faces are curved, wavy and rough; some do not wear in the step, some above a threshold only.
    """
    (case, pair), rng = paper, np.random.default_rng(seed)
    n, size = pair.line.n, (count, 1)
    p0 = rng.uniform(0.0, 60.0, (2, count)) * (rng.random((2, count)) < 0.5)
    k = 10 ** rng.uniform(-8.0, -2.0, (2, count)) * (rng.random((2, count)) < 0.8) / 100.0
    law = law or (lambda k, p0: ThresholdLaw(k, p0))
    cases = [
        replace(
            case, wear_lower=law(k[0, i], p0[0, i]), wear_upper=law(k[1, i], p0[1, i]),
            lower=replace(case.lower, young=float(10 ** rng.uniform(3.3, 6.0))),
            upper=replace(case.upper, young=float(10 ** rng.uniform(3.3, 6.0))),
        )
        for i in range(count)
    ]  # fmt: skip
    block = Block.of(cases, [pair] * count)
    x = (pair.line.r - 30.0) / 1.5
    curved = np.abs(rng.normal(size=size)) * 10 ** rng.uniform(-5.0, -1.0, size)
    gap = curved * (x - rng.uniform(-1.0, 1.0, size)) ** 2
    wave = np.cos(x * rng.uniform(1.0, 12.0, size) + rng.uniform(0.0, 6.0, size))
    gap += 10 ** rng.uniform(-6.0, -2.5, size) * wave
    gap += 10 ** rng.uniform(-7.0, -4.5, size) * rng.normal(size=(count, n))
    load = 10 ** rng.uniform(-1.0, 2.3, count) * pair.line.area.sum()
    if not by_force:
        block = replace(block, by_force=False)
        load = gap.min(axis=1) + 10 ** rng.uniform(-4.0, -1.5, count)
    zero, ones = np.zeros(count), np.ones(count)
    wear = np.zeros((2, count, n))
    step = block.step_wear(wear.astype(int), zero, (2.0 * ones, 0.1 * ones), wear, ones)
    return block, (gap, load, step)


@dataclass
class Bed:
    """What solvers need to know of a block."""

    compliance: Compliance
    by_force: bool


def spring(stiffness, count=1, matrix=None):
    """Return the compliance of elements that give way by their own pressures, or by a matrix."""
    matrix = np.eye(12) / stiffness if matrix is None else matrix
    n, units = len(matrix), np.stack([matrix, 0.0 * matrix])[None]
    r, area = np.linspace(1.0, 2.0, n), np.linspace(0.5, 1.5, n)
    line = Line(r=r, area=area, obliquity=None, pairs=(None,), units=units)
    return Compliance.of(line, np.zeros(count, int), np.ones((count, 2)))


UPPER = Body(Section((28.5, 31.5), 20.0), 1e5, 0.3, "clamped")
WIDE = (20.0, 40.0)


def _layered(*layers):
    """Return a ring of 10 GPa with layers of thickness (mm), E (MPa) and nu."""
    sizes, materials = tuple(h for h, *_ in layers), tuple(Material(e, nu) for _, e, nu in layers)
    return Body(Section(WIDE, 20.0, layers=sizes), 1e4, 0.3, "clamped", materials)


def _plain(r, height, young):
    return Body(Section(r, height), young, 0.3, "clamped")


#: pairs whose compliances are the least symmetric, or nearly singular
HARD = {
    "pin with the axis on a disc": (_plain((0.0, 40.0), 20.0, 1e4), _plain((0.0, 5.0), 20.0, 1e5)),
    "equal discs": (_plain((0.0, 10.0), 10.0, 1e5), _plain((0.0, 10.0), 10.0, 1e5)),
    "soft film, 20 um": (_layered((0.02, 10.0, 0.499)), UPPER),
    "soft film, 1 um": (_layered((0.001, 10.0, 0.4999)), UPPER),
    "incompressible film": (_layered((0.1, 10.0, 0.4999)), UPPER),
    "hard film": (_layered((0.003, 5e5, 0.2)), UPPER),
    "two films": (_layered((0.003, 1e5, 0.3), (0.003, 5e4, 0.3)), UPPER),
    "thin disc": (_plain((0.0, 30.0), 1.4, 500.0), _plain((10.0, 20.0), 20.0, 1e5)),
    "washer": (_plain((5.0, 40.0), 0.5, 1e4), _plain((5.0, 40.0), 5.0, 1e5)),
}
