"""Which body, and which side of an interface, the points of stress belong to."""

from collections.abc import Iterator, Sequence

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.case import Case, Ring, Side
from ringwear_par.elasticity.sections import BODIES, corners
from ringwear_par.errors import Fault, InputError
from ringwear_par.files.text import shortened

#: share of the bodies' size within which a point lies on a face or an edge
_ON = 1e-9


def point_bodies(case: Case) -> list[int]:
    """Return of which body, 0 or 1, each point of a case is. Not collective."""
    assert case.stress is not None
    return [_bodies_at(case, r, z, side)[0] for r, z, side in case.stress.points]


def grid_bodies(case: Case) -> IntArray:
    """Return of which body each point of a case's grid is, (nr, nz); -1: of none, or on an edge."""
    assert case.stress is not None
    grid = case.stress.grid
    if grid is None:
        return np.empty((0, 0), dtype=np.int64)
    r, z = (part.ravel() for part in np.meshgrid(*grid.axes, indexing="ij"))
    bodies = np.full(r.shape, -1)
    for i in (1, 0):  # lower has what belongs to both
        if grid.body in ("both", BODIES[i]):
            bodies[_inside(case, i, r, z)] = i
    for edge in edges(case):
        bodies[np.hypot(r - edge[0], z - edge[1]) <= _ON * _size(case)] = -1
    return bodies.reshape(grid.n)


def check_stress(name: str, case: Case) -> None:
    """Refuse points that are in no body, or where there is no stress. Not collective.

    Parameters
    ----------
    name : what messages call the case.

    Raises
    ------
    InputError : all faults, one sentence each.
    """
    if case.stress is None:
        return
    faults = [
        Fault(f"{name}: {fault}", "stress.points", "conflict")
        for fault in _point_faults(case, case.stress.points)
    ]
    grid = case.stress.grid
    if grid is not None and not any(
        _overlaps(grid.r, ring.r) and _overlaps(grid.z, ring.z)
        for body, ring in zip(BODIES, case.rings, strict=True)
        if grid.body in ("both", body)
    ):
        bodies = "both bodies" if grid.body == "both" else grid.body
        sentence = (
            f"{name}: stress.grid.r = {list(grid.r)}, stress.grid.z = {list(grid.z)}: lie outside "
            f"{bodies}; must have a part of it (mm)"
        )
        faults.append(Fault(sentence, "stress.grid.r", "conflict"))
    most = min(max(ring.r[1] - ring.r[0], ring.z[1] - ring.z[0]) for ring in case.rings)
    if case.stress.exclude >= most:
        sentence = (
            f"{name}: stress.exclude = {case.stress.exclude:g}: leaves nothing of a body; must be "
            f"less than {most:g} (mm)"
        )
        faults.append(Fault(sentence, "stress.exclude", "conflict"))
    if faults:
        raise InputError(*faults)


def _point_faults(case: Case, points: Sequence[tuple[float, float, Side]]) -> Iterator[str]:
    """Yield the faults of points."""
    around, size = edges(case), _size(case)
    before: dict[tuple[float, float, Side], int] = {}
    for i, (r, z, side) in enumerate(points):
        subject = f"stress.points[{i}] = {shortened([r, z, side] if side else [r, z])}"
        first = before.setdefault((r, z, side), i)
        without, bodies = _bodies_at(case, r, z, ""), _bodies_at(case, r, z, side)
        if first < i:
            yield f"{subject}: is stress.points[{first}] as well; must be another point"
        elif np.hypot(*(around - [r, z]).T).min() <= _ON * size:
            yield f"{subject}: lies on an edge; must be beside it, as stress is not defined"
        elif not without:
            yield f"{subject}: lies outside both bodies; must be in one of them (mm)"
        elif len(without) > 1 and not side:
            yield (
                f'{subject}: lies on the faces of both bodies; must have its side, "below" for '
                'lower or "above" for upper'
            )
        elif not bodies:
            yield f'{subject}: lies on a face with no body {side} it; must be without "{side}"'
        elif not side and (
            np.abs(_interfaces(case, case.rings[bodies[0]]) - z) <= _ON * size
        ).any():  # fmt: skip
            yield f'{subject}: lies between two layers; must have its side, "above" or "below"'


def _overlaps(first: tuple[float, float], second: tuple[float, float]) -> bool:
    return first[0] <= second[1] and second[0] <= first[1]


def _size(case: Case) -> float:
    return max(abs(x) for ring in case.rings for x in (*ring.r, *ring.z))


def _bodies_at(case: Case, r: float, z: float, side: Side) -> list[int]:
    """Return the bodies that have a point, on a side of a face where it lies on one."""
    at = np.array([r]), np.array([z])
    bodies = [i for i in (0, 1) if _inside(case, i, *at)[0]]
    return [i for i in bodies if not side or _material_side(case, i, r, z) in ("", side)]


def _material_side(case: Case, i: int, r: float, z: float) -> Side:
    """Return on which side of a point the body is that it lies on a face of; "": inside it."""
    ring = case.rings[i]
    far_face = ring.z[0] if i == 0 else ring.z[1]
    if abs(z - float(_face(case, ring, np.array([r]))[0])) <= _ON * _size(case):
        return _SIDES[i]
    return _SIDES[1 - i] if abs(z - far_face) <= _ON * _size(case) else ""


def _interfaces(case: Case, ring: Ring) -> FloatArray:
    """Return the heights of the interfaces between the layers of a ring, mm."""
    depths = np.cumsum(case.section(ring).layers)
    return case.lower.z[1] - depths if ring is case.lower else case.upper.z[0] + depths


#: on which side of its contact face a body is
_SIDES: tuple[Side, Side] = ("below", "above")


def _face(case: Case, ring: Ring, r: FloatArray) -> FloatArray:
    """Return the heights of a contact face in the frame of the case, mm."""
    inside = np.clip(r, *ring.r)
    depth = case.section(ring).depth(inside)
    return case.lower.z[1] + depth if ring is case.lower else case.upper.z[0] - depth


def _inside(case: Case, i: int, r: FloatArray, z: FloatArray) -> BoolArray:
    """Tell which points are in lower (0) or upper (1), their faces included."""
    ring, on = case.rings[i], _ON * _size(case)
    face = _face(case, ring, r)
    low, high = (ring.z[0], face) if i == 0 else (face, ring.z[1])
    return (r >= ring.r[0] - on) & (r <= ring.r[1] + on) & (z >= low - on) & (z <= high + on)


def edges(case: Case) -> FloatArray:
    """Return (e, 2) mm, corners, ends of interfaces and of the contact line, off the axis."""
    points = []
    for ring in case.rings:
        radii = np.array([*ring.r, *corners(case.section(ring)), *case.contact])
        face = _face(case, ring, radii)
        far_face = ring.z[0] if ring is case.lower else ring.z[1]
        points += [(r, z) for r, z in zip(radii, face, strict=True) if r > 0.0]
        points += [(r, far_face) for r in ring.r if r > 0.0]
        points += [(r, z) for z in _interfaces(case, ring) for r in ring.r if r > 0.0]
    return np.array(points)
