"""What a history comes to, in the numbers of a tribologist."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.cases.case import density_keys
from ringwear_par.elasticity.boundary_fields import BODIES, Which
from ringwear_par.errors import InputError
from ringwear_par.results.edge_elements import edge_elements
from ringwear_par.results.layer_ends import WornThrough, worn_through

if TYPE_CHECKING:
    from ringwear_par.results.result import Result


@dataclass(frozen=True)
class Worn:
    """What a body has lost; None is not known.

    Parameters
    ----------
    body : "lower" or "upper".
    deepest : um.
    volume : mm3.
    mass : mg.
    no_mass : why there is none though something of the body has a density, "" else.
    rate, rate_now : um/h, mean depth over the nominal area, over the whole time and at its end.
    specific : mm3/(N m), volume by load and sliding distance.
    layers : of a body with layers, which it may have though it does not wear.
    """

    body: str
    deepest: float
    volume: float
    mass: float | None
    rate: float | None
    rate_now: float | None
    specific: float | None
    layers: "WornLayers | None" = None
    no_mass: str = ""


@dataclass(frozen=True)
class WornLayers:
    """What has become of the layers of a body.

    Parameters
    ----------
    volumes : mm3, lost by each from the contact face inwards; the last by the body itself.
    share : of the contact area where all of them are worn through.
    time : s, when that began; None: not yet.
    thinnest, thickest : um, least and most that is left of all of them.
    each : of them, those that are worn through somewhere.
    """

    volumes: tuple[float, ...]
    share: float
    time: float | None
    thinnest: float
    thickest: float
    each: tuple[WornThrough, ...]


@dataclass(frozen=True)
class KeyNumbers:
    """What a history has come to at its last state.

    Parameters
    ----------
    mean_pressure : MPa, over the nominal annulus, as load.pressure.
    largest_pressure, smallest_pressure : MPa, of elements.
    largest_at : mm, radius.
    largest_beside_edge : whether that element is beside an edge of contact, see ``edge_elements``.
    touching : elements in contact.
    sliding : at the mean radius speed (mm/s), p V (MPa mm/s) and distance (m); None: not stored.
    penetration, worn_off, elastic : um. The first is the sum of the others: the depth worn off
        both faces in the mean over what presses, and the change of the elastic part. None where
        a face is not flat: the approach also closes gaps there.
    bodies : those that wear.
    """

    mean_pressure: float
    largest_pressure: float
    largest_at: float
    largest_beside_edge: bool
    smallest_pressure: float
    touching: int
    sliding: tuple[float, float, float] | None
    penetration: float
    worn_off: float | None
    elastic: float | None
    bodies: tuple[Worn, ...]


def key_numbers(result: "Result") -> KeyNumbers:
    """Return what a history has come to. Not collective.

    Raises
    ------
    InputError : the result was stored without its last state.
    """
    if result.checkpoint is None:
        raise InputError(f"{result.name}: holds no last state; must be one of a run")
    state, about, line = result.checkpoint.arrays, result.attributes, result.line
    last = {name: float(values[-1]) for name, values in result.histories.items()}
    p, load = state["pressure"], state["pressure"] * line.area
    mean, sliding = result.checkpoint.numbers["force"] / nominal_area(result), None
    if "omega" in about:
        # which files of before it have not
        radius = float(about.get("mean_radius", 0.5 * (line.edges[0] + line.edges[-1])))
        speed = about["omega"] * radius
        sliding = speed, mean * speed, 1e-3 * about["angle"] * radius
    penetration, worn, elastic = 1e3 * last["penetration"], None, None
    if not {"face_lower", "face_upper"} & about.keys() and load.sum() > 0:
        worn = 1e3 * float(load @ state["wear"].sum(axis=0) / load.sum())
        elastic = penetration - worn
    return KeyNumbers(
        mean, p.max(), line.r[p.argmax()], bool(edge_elements(p)[p.argmax()]), p.min(),
        int(np.count_nonzero(p > 0.0)), sliding, penetration, worn, elastic,
        tuple(
            _worn(result, number, body)
            for number, body in enumerate(BODIES)
            if about.get(f"law_{body}", last[f"worn_volume_{body}"])
        ),
    )  # fmt: skip


def nominal_area(result: "Result") -> float:
    """Return the area (mm2) where the bodies face each other; of older files, of the elements."""
    return float(result.attributes.get("nominal_area", result.line.area.sum()))


def _worn(result: "Result", number: int, body: Which) -> Worn:
    assert result.checkpoint is not None
    state, about, line = result.checkpoint.arrays, result.attributes, result.line
    volume = float(result.histories[f"worn_volume_{body}"][-1])
    hours = float(result.histories["time"][-1]) / 3600.0
    energy, area = float(result.histories["dissipated_energy"][-1]), nominal_area(result)
    rate = now = specific = None
    layers = _layers(result, body)
    mass, no_mass = _mass(about, body, (volume,) if layers is None else layers.volumes)
    if hours > 0:
        rate = 1e3 * volume / area / hours
        now = 3.6e6 * float(state["rates"][number] @ line.area) / area
    if about.get("friction") and energy > 0:
        # load times sliding distance of every place, which is energy over friction
        specific = 1e3 * volume * about["friction"] / energy
    deepest = 1e3 * state["wear"][number].max()
    return Worn(body, deepest, volume, mass, rate, now, specific, layers, no_mass)


def _mass(
    about: Mapping[str, Any], body: Which, volumes: Sequence[float]
) -> tuple[float | None, str]:
    """Return the mass that a body has lost, mg; or None, and why where some density is known.

    Parameters
    ----------
    volumes : mm3, lost by each layer from the contact face inwards, and by the body itself.
    """
    unknown = (np.nan,) * (len(volumes) - 1)
    densities = (
        *about.get(f"density_{body}_layers", unknown),
        about.get(f"density_{body}", np.nan),
    )
    if np.isnan(densities).all():
        return None, ""
    keys = density_keys(body, len(unknown))
    lost = [part for part in zip(keys, densities, volumes, strict=True) if part[2] > 0.0]
    if missing := ", ".join(key for key, density, _ in lost if np.isnan(density)):
        return None, f"{missing} not given: no mass"
    return 1e3 * float(sum(density * volume for _, density, volume in lost)), ""


def _layers(result: "Result", body: Which) -> WornLayers | None:
    """Return what has become of the layers of a body; None where it has none."""
    if f"share_through_{body}" not in result.layers:
        return None
    left = np.atleast_2d(result.layers[f"layer_left_{body}"])[-1]
    time = float(result.attributes.get(f"time_through_{body}", np.nan))
    return WornLayers(
        tuple(result.layers[f"worn_volume_{body}_layers"][-1].tolist()),
        float(result.layers[f"share_through_{body}"][-1]),
        None if np.isnan(time) else time,
        1e3 * float(left.min()),
        1e3 * float(left.max()),
        tuple(worn_through(result, body)),
    )
