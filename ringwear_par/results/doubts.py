"""What makes an answer doubtful though it was computed: said by ``run``, flagged by ``sweep``."""

from collections.abc import Iterator

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.elasticity.boundary_fields import BODIES
from ringwear_par.elasticity.mesh import ContactLine
from ringwear_par.elasticity.pair import ContactCompliance
from ringwear_par.elasticity.slopes import case_slopes
from ringwear_par.elasticity.stress_fields import StressHistory
from ringwear_par.elasticity.stress_measures import mises
from ringwear_par.history.balances import Balances
from ringwear_par.history.model import WearModel
from ringwear_par.history.stability import stable_step, stable_steps
from ringwear_par.history.state import State
from ringwear_par.history.stresses import StressObserver
from ringwear_par.results.implausible import Doubt, implausible

#: fewer elements in contact than this do not resolve it
_FEW_ELEMENTS = 10
#: largest approach or wear, in heights of a body, that small displacements describe
_MOST_MOVED = 0.05
#: largest defect of the boundary elements' own balances
_MOST_DEFECT = 0.01
#: likewise of the symmetry of a compliance without layers: pressures are off by as much at most,
#: but under wide flat washers and the like, far less
_MOST_ASYMMETRIC = 3e-3
#: and with layers: pressures under nearly incompressible films are off by up to three times as much
_MOST_FILM_DEFECT = 5e-3
#: largest angle (degrees) between faces that touch, and share of the load that may exceed it
_MOST_ANGLE, _LOAD_ASIDE = 15.0, 0.05
#: largest error of a pressure that comes of making the compliance symmetric
_MOST_ASYMMETRY = 0.05
#: share of a layer, meant by load, that is worn off, and by which its modulus differs from what is
#: under it, from which on the unworn stack is another
_MOST_OF_LAYER, _OTHER_MODULUS = 0.25, 0.1


#: pressure, or stress, of an outermost element over that of the fourth, from which on it is
#: infinite there
_RISING = 1.2


def doubts(model: WearModel, state: State, balances: Balances) -> tuple[Doubt, ...]:
    """Return where the last state of a case leaves what the method is made for. Not collective.

    Parameters
    ----------
    balances : the worst of its history.
    """
    return doubts_at(model.case, model.line, model.compliance, state, balances, model.asymmetry)


def doubts_at(
    case: Case,
    line: ContactLine,
    compliance: ContactCompliance,
    state: State,
    balances: Balances,
    asymmetry: tuple[float, int],
) -> tuple[Doubt, ...]:
    """Return the same of a case by itself. Not collective.

    Parameters
    ----------
    line, compliance : of the case, the elements having followed the wear where they do.
    balances : the worst of its history.
    asymmetry : see ``WearModel.asymmetry``.
    """
    found = list(implausible(case))
    height = min(ring.z[1] - ring.z[0] for ring in case.rings)
    moved = max(state.contact.approach, float(state.wear.max()))
    if moved > _MOST_MOVED * height:
        found.append(
            Doubt(
                "large_displacement",
                f"approach or wear of {moved:.3g} mm is more than 5 % of a body's height: small "
                "displacements and the mesh of the unworn rings no longer describe it",
            )
        )
    if any(case.open_ends) and state.contact.approach > case.smallest_gaps[1]:
        found.append(
            Doubt(
                "contact_beyond_mesh",
                f"the approach of {state.contact.approach:.6g} mm exceeds the smallest gap, "
                f"{case.smallest_gaps[1]:.6g} mm, of the faces that mesh.contact leaves out: they "
                "may touch there too, which is not computed",
            )
        )
    touching, n = np.count_nonzero(state.contact.pressure), len(state.contact.pressure)
    if 0 < touching < min(_FEW_ELEMENTS, n):
        found.append(
            Doubt(
                "few_elements_in_contact",
                f"{touching} of {n} elements are in contact at the end: too few to resolve it; "
                "mesh.contact = [r1, r2] puts them where contact is",
            )
        )
    layered, symmetry_defect = any(ring.layers for ring in case.rings), compliance.symmetry_defect
    held = max(balances.torque, balances.reaction)
    defect = max(held, 0.0 if layered else symmetry_defect)
    if held > _MOST_DEFECT or (not layered and symmetry_defect > _MOST_ASYMMETRIC):
        found.append(
            Doubt(
                "coarse_mesh",
                f"the boundary elements' own balances are wrong by {defect:.2g}: a finer mesh "
                "(mesh.contact_elements) or thicker bodies are needed",
            )
        )
    elif layered and symmetry_defect > _MOST_FILM_DEFECT:
        found.append(
            Doubt(
                "coarse_film",
                f"the compliance of bodies with layers is asymmetric by "
                f"{symmetry_defect:.2g}, as of thin films that are soft or nearly "
                "incompressible: pressures may be wrong by three times as much; compare with a "
                "finer mesh (mesh.contact_elements)",
            )
        )
    return (
        *found,
        *_other_stack(case, line, state),
        *_unlike_slopes(case, line, compliance, state),
        *_asymmetric(line, *asymmetry),
    )


def _other_stack(case: Case, line: ContactLine, state: State) -> list[Doubt]:
    """Return whether layers of another modulus are worn that elasticity still has."""
    if case.follows_wear:
        return []
    found, load = [], line.area * state.contact.pressure
    for i, (body, ring) in enumerate(zip(("lower", "upper"), case.rings, strict=True)):
        if not (ring.layers and state.wear[i].any() and load.any()):
            continue
        ends = case.layer_ends(i)
        starts = np.concatenate([np.zeros_like(ends[:1]), ends[:-1]])
        worn = (np.clip(state.wear[i], starts, ends) - starts) / (ends - starts)
        under = [*(layer.young for layer in ring.layers[1:]), ring.young]
        for number, (layer, below) in enumerate(zip(ring.layers, under, strict=True)):
            share = float(worn[number] @ load / load.sum())
            if share > _MOST_OF_LAYER and abs(layer.young / below - 1.0) > _OTHER_MODULUS:
                found.append(
                    Doubt(
                        "worn_layer",
                        f"{100.0 * share:.0f} % of {body}.layers[{number}] is worn off where it "
                        f"bears load, and its modulus, {layer.young:g} MPa, is not the "
                        f"{below:g} MPa under it: elasticity is that of the unworn layers, "
                        'with mesh.geometry = "updated" that of what is left of them',
                    )
                )
    return found


def _unlike_slopes(
    case: Case, line: ContactLine, compliance: ContactCompliance, state: State
) -> list[Doubt]:
    """Return whether faces that touch slope by different angles, now or as elements have them."""
    p = state.contact.pressure
    if not any(ring.face for ring in case.rings):
        return []  # contact does not last where wear alone slopes faces apart
    slopes = [*case_slopes(case.sections, line, case.mesh, state.wear), compliance.slope]
    angles = np.degrees(np.arctan(slopes))
    load = line.area * p
    apart = (np.ptp(angles, axis=0) > _MOST_ANGLE) & (p > 0.0)
    share = float(load[apart].sum() / load.sum()) if apart.any() else 0.0
    if share <= _LOAD_ASIDE:
        return []
    e = int(np.where(apart, load, 0.0).argmax())
    lower, upper, acts = angles[:, e]
    return [
        Doubt(
            "unlike_slopes",
            f"{100.0 * share:.2g} % of the load is borne where the pressure acts along a normal "
            f"more than {_MOST_ANGLE:g} degrees off that of a face: at r = {line.r[e]:.6g} mm "
            f"lower slopes by {lower:.3g}, upper by {upper:.3g} degrees, and the pressure is that "
            f"on a face of {acts:.3g} degrees"
            + ('; mesh.geometry = "updated" follows the worn faces' * (not case.follows_wear)),
        )
    ]


def _asymmetric(line: ContactLine, error: float, e: int) -> list[Doubt]:
    """Return whether making the compliance symmetric spoiled pressures."""
    if error <= _MOST_ASYMMETRY:
        return []
    return [
        Doubt(
            "asymmetric_compliance",
            f"a pressure at r = {line.r[e]:.6g} mm was about {error:.2g} off that of the "
            "collocated equations, whose matrix was made symmetric: a finer mesh or a milder "
            "grading is needed",
        )
    ]


def infinite_stress(
    case: Case, history: StressHistory | None, line: ContactLine, state: State
) -> tuple[Doubt, ...]:
    """Return whether the largest stress is where it would be infinite. Not collective.

    Parameters
    ----------
    state : the last one.
    """
    if history is None or not history.states:
        return ()
    largest, p = history.states[-1].of_both, state.contact.pressure
    for end, further in ((0, 3), (-1, -4)):
        r, reach = line.edges[end], history.exclude * (1.0 + 1e-6) + 3.0 * line.width[end]
        height = min(abs(largest.z - z) for z in (case.lower.z[1], case.upper.z[0]))
        beside = np.hypot(largest.r - r, height) <= reach + state.wear.max()
        if r > 0.0 and beside and p[end] > _RISING * p[further]:
            return (
                Doubt(
                    "infinite_stress",
                    f"the largest von Mises stress, {largest.mises:.5g} MPa, is found beside the "
                    f"edge of contact at r = {r:.6g} mm, where it is infinite as long as no wear "
                    "has rounded the edge: what is found grows as stress.exclude, now "
                    f"{history.exclude:g} mm, is made smaller",
                ),
            )
    return ()


def worn_points(
    case: Case, history: StressHistory | None, seen: StressObserver | None
) -> tuple[Doubt, ...]:
    """Return whether points of stress lie where wear has been at the last of its states.

    Not asked of points on faces, which are of the faces as they are, nor of those that have no
    stress, their layer being worn through. Not collective.

    Parameters
    ----------
    seen : what has kept the stresses, and knows the wear at the last of them.
    """
    wear = None if seen is None else seen.wear
    if history is None or seen is None or wear is None or not wear.any() or case.follows_wear:
        return ()
    assert case.stress is not None
    state, under = history.states[-1], case.line.element_at(history.points[:, 0])
    bodies, depths = seen.stresses.of_points, seen.stresses.depths
    worn = np.where(under >= 0, wear[bodies, under], 0.0)
    known = np.isfinite(state.points).all(axis=1)
    found = np.flatnonzero(known & (depths > 0.0) & (worn > depths)).tolist()
    if not found:
        return ()
    first, *more = found
    r, z, _ = case.stress.points[first]
    return (
        Doubt(
            "worn_points",
            f"stress.points[{first}], at r = {r:.6g}, z = {z:.6g} mm, lies {depths[first]:.4g} mm "
            f"under the face of {BODIES[bodies[first]]}, of which {worn[first]:.4g} mm is worn off "
            f"there at t = {state.time:g} s"
            + (f" ({len(more)} more of stress.points likewise)" if more else "")
            + ': with mesh.geometry = "fixed" stresses are those of the unworn shape, with '
            '"updated" there is none where nothing is left',
        ),
    )


def infinite_at_interfaces(case: Case, history: StressHistory | None) -> tuple[Doubt, ...]:
    """Return which bodies' largest stress is beside the end of an interface. Not collective."""
    if history is None or not history.states:
        return ()
    state = history.states[-1]
    found = [
        Doubt(
            "infinite_stress_at_interface",
            f"the largest von Mises stress of {body}, {largest.mises:.5g} MPa, is found beside the "
            f"free edge of the interface under {body}.layers[{number}], at r = {r:.6g}, "
            f"z = {z:.6g} mm, where stress between two materials is infinite: what is found grows "
            f"as stress.exclude, now {history.exclude:g} mm, is made smaller",
        )
        for i, (body, largest) in enumerate(zip(BODIES, state.largest, strict=True))
        for number, r, z, reach in _infinite_ends(case, history, i)
        if np.hypot(largest.r - r, largest.z - z) <= reach
    ]
    return tuple(found)


def _infinite_ends(
    case: Case, history: StressHistory, body: int
) -> Iterator[tuple[int, float, float, float]]:
    """Give the layer over each interface's free end where stresses rise, its place, and how near.

    All in mm; beyond ``stress.exclude`` a few elements are near.
    """
    middles, stress = history.interfaces[body].r, history.states[-1].interfaces[body]
    for number, z in enumerate(history.interfaces[body].z):
        values = mises(stress[number]).max(axis=0)
        for r, end, further in zip(case.rings[body].r, (0, -1), (3, -4), strict=True):
            if r > 0.0 and values[end] > _RISING * values[further]:
                reach = history.exclude * (1.0 + 1e-6) + 6.0 * abs(middles[end] - r)
                yield number, r, float(z), reach


def instability(model: WearModel) -> tuple[Doubt, ...]:
    """Return whether explicit steps are too long. Collective."""
    case = model.case
    if case.time.scheme != "explicit":
        return ()
    limit, step = stable_step(model), case.time.step
    return () if step <= limit else (_unstable(step, limit),)


def unstable(model: WearModel) -> dict[int, Doubt]:
    """Return which of B histories have explicit steps that are too long."""
    if model.case.time.scheme != "explicit":
        return {}
    steps = [case.time.step for case in model.given.cases]
    both = enumerate(zip(steps, stable_steps(model), strict=True))
    return {i: _unstable(step, limit) for i, (step, limit) in both if step > limit}


def _unstable(step: float, limit: float) -> Doubt:
    return Doubt(
        "unstable_explicit_step",
        f"explicit scheme: time.step = {step:.6g} s is {step / limit:.3g} times its stability "
        f"limit; the largest stable step on this mesh is {limit:.6g} s (beyond it profiles "
        "oscillate, and with p0 > 0 the wear is too large)",
    )
