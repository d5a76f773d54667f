"""Cases that are refused before anything is computed, for their memory or smallest lengths."""

import os

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.law_trials import refuse_bad_laws
from ringwear_par.cases.numbers import number_faults
from ringwear_par.cases.stress_points import check_stress
from ringwear_par.elasticity.bem.boundary import count_elements, zone_meshes
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError
from ringwear_par.files.text import toml_value

#: about how many points of both bodies the search for the largest stress computes
SEARCHED = 4000.0
#: of a machine's memory that a run may take
_SHARE_OF_MEMORY = 0.9
#: least length of an element, and radius of a hole, in outer radii
_SHORTEST = 1e-11


def memory_needed(case: Case, ranks: int) -> float:
    """Return an estimate of the bytes that a run needs on all ranks together.

    Those are: the systems of the boundary elements; on every rank the compliance and its copies,
    and the responses of whole boundaries where the case stores their fields; on one rank the
    history.
    """
    n, rows = float(case.mesh.contact_elements), case.stored_rows
    elements = max(count_elements(case.section(r), case.contact, case.mesh) for r in case.rings)
    # two unknowns at each of two nodes an element; on the fixed face, n/2 elements, at one
    numbers = _numbers_of_systems(4.0 * elements - n, n, ranks)
    numbers += ranks * 8.0 * n**2 + len(case.output.fields) * n * rows
    # displacements of two nodes an element and its traction, of both bodies and n loads
    responses = ranks * 2.0 * 9.0 * n * elements
    if case.output.boundary != "none":
        # an element that is stored has six coordinates, six displacements and more
        stored = 1.0 if case.output.boundary == "last" else rows
        numbers += responses + 2.0 * 15.0 * elements * stored
    if case.stress is not None:
        points, stored = stress_numbers(case)
        numbers += responses + 6.0 * n * points + (ranks + 2.0) * stored
    return 8.0 * numbers


def stress_numbers(case: Case) -> tuple[float, float]:
    """Return at how many points stress is computed, and how many numbers are stored of it."""
    assert case.stress is not None
    rows = 1.0 if case.stress.times == "last" else case.stored_rows
    if isinstance(case.stress.times, tuple):
        rows = min(rows, float(len(case.stress.times)))
    # both sides of interfaces have some 2.5 times the elements of the contact line each
    along = 5.0 * case.mesh.contact_elements * sum(len(ring.layers) for ring in case.rings)
    # looking for the largest stress takes some of its own
    return case.stress.size + SEARCHED, rows * (
        12.0 * case.stress.size + 12.0 * case.mesh.contact_elements + 7.0 * along
    )


def _numbers_of_systems(unknowns: float, loads: float, ranks: int) -> float:
    """Return how many numbers the systems of a body take at once, on all ranks together.

    Parameters
    ----------
    unknowns : of the (r, z) system of the larger body; that of theta has half as many.
    loads : right-hand sides.
    """
    matrix, right = unknowns**2, unknowns * loads
    rows = 1.25 * matrix + 1.5 * right
    # of one body after another: its rows, their factors, the values on its whole boundary
    alone = 2.0 * rows + 2.25 * right
    from ringwear_par.elasticity.bem.solve import has_scalapack, solved_on_one_rank

    if solved_on_one_rank(round(unknowns), ranks):
        return ranks * alone
    # its rows, the copies of PETSc 3.18, measured on 2 ranks, the solution and values on each rank
    copies = 6.0 if has_scalapack() else 1.0 + 3.0 * ranks
    return rows + copies * (matrix + right) + ranks * 3.75 * right


def check_case(case: Case, ranks: int, name: str, known_mesh: bool = False) -> None:
    """Refuse a case that cannot be computed, as far as that is known before. Not collective.

    Parameters
    ----------
    known_mesh : whether a case of the same mesh was checked before.

    Raises
    ------
    InputError : the faults of its numbers, or of its laws, or its memory or mesh.
    """
    if case.rebuild is None:  # those of a case that was read were checked then
        if faults := number_faults(case, name):
            raise InputError(*faults)
        check_stress(name, case)
    refuse_bad_laws(case, name)
    check_memory(case, ranks, name)  # first: a mesh takes memory as well
    if not known_mesh:
        check_mesh(case, name)


def check_memory(case: Case, ranks: int, name: str) -> None:
    """Refuse a case that takes more memory than this machine has, all ranks on it. Not collective.

    Raises
    ------
    InputError : with the memory needed and the memory there is.
    """
    needed = memory_needed(case, ranks)
    installed = float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    if needed <= _SHARE_OF_MEMORY * installed:
        return
    taking = [f"mesh.contact_elements = {case.mesh.contact_elements}"]
    if not case.time.adaptive:
        taking.append(f"time.steps = {case.time.steps}")
    if (stress := case.stress) is not None:
        taking += [] if stress.grid is None else [f"stress.grid.n = {list(stress.grid.n)}"]
        taking += [f"stress.points: {len(stress.points)} of them"] * bool(stress.points)
        taking += [f"stress.times = {toml_value(stress.times)}"] * (stress.times != "last")
    taking.append(f"output.every = {case.output.every}")
    raise InputError(
        f"{name}: {', '.join(taking)}: needs about {needed / 1e9:.3g} GB of memory, this machine "
        f"has {installed / 1e9:.3g} GB; must be less"
    )


def check_mesh(case: Case, name: str) -> None:
    """Refuse a hole, or elements, whose size drowns in round-off. Not collective.

    Raises
    ------
    InputError : with the smallest length.
    """
    for body, ring in zip(BODIES, case.rings, strict=True):
        fine, least = case.stress is not None, _SHORTEST * ring.r[1]
        zones = zone_meshes(case.section(ring), case.line, case.mesh, fine=fine)
        ends = np.concatenate([zone.nodes[zone.elements] for zone in zones])
        shortest = np.hypot(*(ends[:, 2] - ends[:, 0]).T).min()
        what = f"mesh.grading, mesh.contact_elements or {body}.layers: the shortest element"
        if 0.0 < ring.r[0] < least:
            what, shortest = f"{body}.r[0]", ring.r[0]
        if shortest < least:
            raise InputError(f"{name}: {what} is {shortest:.1e} mm; must be >= {least:.1e} mm")
