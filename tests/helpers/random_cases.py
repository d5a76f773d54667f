"""Random rings, faces, loads, schedules and laws: every case must run and keep its balances.

Ranges: radii 0 to 45 mm, heights 5 to 20 mm, moduli 1e3 to 1e6 MPa, Poisson's ratios 0 to 0.45,
friction 0.05 to 0.8; faces flat, chamfered, crowned, conical, filleted or wavy to 0.05 mm; mean
pressures 1 to 300 MPa, or displacements to 0.5 % of the height; force, displacement and omega
numbers or tables with unloading, lift-off, reloading and stops; every law of wear on either body,
to depths of about 1e-4 to 0.03 mm; implicit and adaptive steps; 16 to 48 contact elements of
grading 1 to 3.
"""

import math

import numpy as np

_END = 100.0
_POINTS = 81


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(10 ** rng.uniform(math.log10(low), math.log10(high)))


def _face(rng: np.random.Generator, r: tuple[float, float], z: float, up: float) -> list:
    """Return a random smooth or broken face as samples; ``up`` is where the material is not."""
    x = np.linspace(0.0, 1.0, _POINTS)
    depth = _log(rng, 1e-4, 0.05)
    kind = rng.integers(4)
    if kind == 0:  # crown, or sphere
        top = rng.uniform(0.2, 0.8) if r[0] > 0 else 0.0
        fall = ((x - top) / max(top, 1.0 - top)) ** 2
    elif kind == 1:  # cone
        fall = x if rng.random() < 0.5 or r[0] == 0 else 1.0 - x
    elif kind == 2:  # fillets at the edges
        fall = np.maximum(np.abs(2.0 * x - 1.0) - 0.7, 0.0) ** 2 / 0.09
    else:  # waves
        fall = 0.5 - 0.5 * np.cos(2.0 * np.pi * rng.integers(1, 4) * x)
    radii = r[0] + (r[1] - r[0]) * x
    return np.stack([radii, z + up * depth * fall], axis=1).tolist()


def _law(rng: np.random.Generator, keys: dict, table: str, pv: float, mu: float) -> str:
    """Add a random law that wears 1e-4 to 0.03 mm in all at the mean p V."""
    law = str(rng.choice(["threshold", "archard", "power", "table", "running-in", "non-local"]))
    rate, pressure = _log(rng, 1e-4, 0.03) / _END, keys["pressure"]
    k = rate / (mu * pv)
    keys[f"{table}.law"] = law
    if law in ("threshold", "running-in", "non-local"):
        keys[f"{table}.k"] = k
        keys[f"{table}.p0"] = float(rng.choice([0.0, 0.3, 0.8]) * pressure)
    if law == "threshold" and rng.random() < 0.3:
        keys[f"{table}.k"] = [[0.0, k], [30.0, 0.0], [60.0, 0.0], [61.0, 2.0 * k]]
    if law == "archard":
        keys[f"{table}.k"] = rate / pv
    if law == "power":
        m, n = float(rng.uniform(1.0, 3.0)), float(rng.uniform(0.5, 1.5))
        keys.update({f"{table}.m": m, f"{table}.n": n})
        keys[f"{table}.k"] = rate / (pressure**m * (pv / pressure) ** n)
    if law == "table":
        keys[f"{table}.table"] = [[0.0, 0.0], [0.5 * pv, 0.1 * rate], [pv, rate],
                                  [3.0 * pv, 1.5 * rate]]  # fmt: skip
    if law == "running-in":
        keys[f"{table}.k_start"] = float(rng.uniform(1.0, 20.0)) * k
        if rng.random() < 0.5:
            keys[f"{table}.depth"] = _log(rng, 1e-4, 1e-2)
        else:
            keys[f"{table}.distance"] = _log(rng, 10.0, 1e4)
    if law == "non-local":
        keys[f"{table}.length"] = float(rng.uniform(0.02, 0.3)) * keys["width"]
    return law


def random_case(rng: np.random.Generator) -> tuple[dict, str]:
    """Return the keys of a random case, and what sort of case it is."""
    inner = 0.0 if rng.random() < 0.25 else float(rng.uniform(3.0, 30.0))
    lower = inner, inner + float(rng.uniform(4.0, 15.0))
    width = float(rng.uniform(0.15, 1.0)) * (lower[1] - lower[0])
    where = str(rng.choice(["inside", "equal", "inner overlap", "outer overlap"]))
    if where == "equal":
        upper = lower
    elif where == "inside":
        start = 0.0 if inner == 0.0 and rng.random() < 0.5 else lower[0] + float(
            rng.uniform(0.0, 1.0) * (lower[1] - lower[0] - width))  # fmt: skip
        upper = start, start + width
    elif where == "inner overlap" and lower[0] > 1.0:
        upper = lower[0] * float(rng.uniform(0.7, 0.95)), lower[0] + width
    else:
        upper = lower[1] - width, lower[1] + float(rng.uniform(0.5, 5.0))
    bottom, top = float(rng.uniform(5.0, 20.0)), float(rng.uniform(5.0, 20.0))
    contact = max(lower[0], upper[0]), min(lower[1], upper[1])
    pressure, mu = _log(rng, 1.0, 300.0), float(rng.uniform(0.05, 0.8))
    omega = _log(rng, 0.1, 30.0)
    young = _log(rng, 1e3, 1e6), _log(rng, 1e3, 1e6)
    keys: dict = {
        "lower.r": list(lower), "lower.z": [0.0, bottom], "lower.young": young[0],
        "lower.poisson": float(rng.uniform(0.0, 0.45)),
        "upper.r": list(upper), "upper.z": [bottom, bottom + top], "upper.young": young[1],
        "upper.poisson": float(rng.uniform(0.0, 0.45)),
        "upper.grip": str(rng.choice(["clamped", "platen"])),
        "contact.friction": mu, "load.omega": omega,
        "mesh.contact_elements": int(rng.integers(16, 49)),
        "mesh.grading": float(rng.uniform(1.0, 3.0)),
        "pressure": pressure, "width": contact[1] - contact[0],
    }  # fmt: skip
    shapes = []
    for body, r, z, up in (("lower", lower, bottom, -1.0), ("upper", upper, bottom, 1.0)):
        draw = rng.random()
        if draw < (0.25 if body == "lower" else 0.5):
            keys[f"{body}.profile"] = _face(rng, r, z, up)
            shapes.append("profile")
        elif body == "upper" and draw < 0.7:
            keys["upper.chamfer"] = 0.2 * float(rng.uniform(0.02, 1.0)) * (upper[1] - upper[0])
            shapes.append("chamfer")
    pv = pressure * omega * 0.5 * sum(contact)
    laws = [
        _law(rng, keys, f"wear.{body}", pv, mu)
        for body, chance in (("lower", 0.85), ("upper", 0.4))
        if rng.random() < chance
    ]
    if rng.random() < 0.65:
        keys["load.pressure"] = pressure
        if rng.random() < 0.4:
            keys["load.pressure"] = [[0.0, pressure], [40.0, pressure], [45.0, 0.0], [55.0, 0.0],
                                     [60.0, 1.3 * pressure]]  # fmt: skip
    else:
        down = _log(rng, 2e-4, 5e-3) * min(bottom, top)
        keys["load.control"], keys["load.displacement"] = "displacement", down
        if rng.random() < 0.5:
            keys["load.displacement"] = [[0.0, 0.2 * down], [30.0, down], [50.0, 0.0],
                                         [70.0, 1.2 * down]]  # fmt: skip
    if rng.random() < 0.3:
        keys["load.omega"] = [[0.0, omega], [20.0, 0.2 * omega], [20.5, 0.0], [35.0, 0.0],
                              [36.0, omega]]  # fmt: skip
    adaptive = rng.random() < 0.7
    keys["time.scheme"] = "adaptive" if adaptive else "implicit"
    if adaptive:
        keys["time.end"], keys["time.tolerance"] = _END, _log(rng, 1e-6, 1e-4)
    else:
        keys["time.step"], keys["time.steps"] = _END / 40, 40
    del keys["pressure"], keys["width"]
    return keys, f"{where}; {', '.join(shapes) or 'flat'}; {', '.join(laws) or 'no wear'}"
