"""Records of a wear rig, made up: running-in, rings that grow, noise that remembers; as files."""

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

#: um/h at the end, and how often that at the start; h of running-in, um and h of growth
RATE, START, RUNNING_IN, GROWTH, WARMING = 1.75, 4.0, 1.5, -6.0, 0.55
#: coefficient at the end, how much more at the start, h in which it falls
FRICTION, FRICTION_FALL, FRICTION_TIME = 0.22, 0.05, 1.0
#: of noise: um, its memory from minute to minute, share of torques
NOISE, MEMORY, TORQUE_NOISE = 0.25, 0.8, 0.04
#: N, rad/s, mm, g/mm3: the rig's numbers
FORCE, OMEGA, RADII, DENSITY = 1130.0, 2.0 * np.pi, (28.5, 31.5), 0.0019
AREA = np.pi * (RADII[1] ** 2 - RADII[0] ** 2)
RADIUS = 2.0 / 3.0 * (RADII[1] ** 3 - RADII[0] ** 3) / (RADII[1] ** 2 - RADII[0] ** 2)
RIG = f"""title = "A thrust-washer rig"
[lower]
r = [20.0, 40.0]
z = [0.0, 20.0]
young = 10e3
poisson = 0.3
density = {DENSITY}
[upper]
r = [28.5, 31.5]
z = [20.0, 40.0]
young = 100e3
poisson = 0.3
[contact]
friction = 0.2
[wear.lower]
law = "archard"
k = 1e-9
[load]
force = {FORCE}
omega = "60 rpm"
[time]
scheme = "adaptive"
end = "20 h"
"""


def specific(rate=RATE):
    """Return the specific wear rate, mm3/(N m), of a rate in um/h."""
    return rate / 3.6e6 / (FORCE / AREA * OMEGA * RADIUS) * 1e3


def depth(hours, rate=RATE):
    """Return the worn depth, um, after some hours."""
    return rate * (hours + (START - 1.0) * RUNNING_IN * (1.0 - np.exp(-hours / RUNNING_IN)))


def record(duration, seed, *, rate=RATE, minutes=1.0, growth=GROWTH):
    """Return hours, readings of the displacement (um) and of the torque (N m)."""
    rng = np.random.default_rng(seed)
    hours = np.arange(0.0, duration + 1e-9, minutes / 60.0)
    white = rng.standard_normal(len(hours) + 50) * NOISE * np.sqrt(1.0 - MEMORY**2)
    noise = lfilter([1.0], [1.0, -MEMORY], white)[50:]
    grown = growth * (1.0 - np.exp(-hours / WARMING))
    mu = FRICTION + FRICTION_FALL * np.exp(-hours / FRICTION_TIME)
    torque = mu * FORCE * RADIUS / 1e3 * (1.0 + TORQUE_NOISE * rng.standard_normal(len(hours)))
    return hours, depth(hours, rate) + grown + noise, torque


def comma(value, digits):
    """Return a number with a decimal comma."""
    return f"{value:.{digits}f}".replace(".", ",")


def write_rig(folder, *, seed=1, minutes=2.0):
    """Write case, records in four formats, weighings and measure.toml; return rates by test."""
    folder = Path(folder)
    rng = np.random.default_rng(seed)
    rates = dict(zip(("W1", "W2", "W3", "W4"), RATE * np.exp(0.12 * rng.standard_normal(4)),
                     strict=True))  # fmt: skip
    durations = {"W1": 20.0, "W2": 20.0, "W3": 20.0, "W4": 2.5}
    (folder / "rig.toml").write_text(RIG)
    for number, write in enumerate((_lab_a, _lab_b, _lab_c, _lab_d), start=1):
        name = f"W{number}"
        step = minutes if durations[name] > 5.0 else 1.0
        read = record(durations[name], seed + number, rate=rates[name], minutes=step)
        (folder / f"{name}.csv").write_bytes(write(name, *read))
    rows = ["\ufeffWägungen, Analysenwaage u = 0,1 mg (k = 1)",
            f"Probe;{';'.join(3 * ['m vor / g'] + 3 * ['m nach / g'])}"]  # fmt: skip
    for number, (name, rate) in enumerate(rates.items()):
        before = 41.2 + 0.05 * number
        after = before - AREA * depth(durations[name], rate) * 1e-3 * DENSITY
        masses = [*(3 * [before]), *(3 * [after])]
        cells = [comma(mass + 1e-4 * rng.standard_normal(), 4) for mass in masses]
        rows.append(";".join([name, *cells]))
    (folder / "masses.csv").write_bytes("\r\n".join([*rows, ""]).encode())
    tests = "".join(f'[[test]]\nname = "{name}"\nfile = "{name}.csv"\n' for name in rates)
    (folder / "measure.toml").write_text(
        'case = "rig.toml"\n\n[measure]\nmasses = { file = "masses.csv", sd = "0.1 mg" }\n'
        'uncertainty = { "load.force" = "6 N", "lower.density" = { relative = 0.004 } }\n\n' + tests
    )
    return rates


def _lab_a(name, hours, depths, torques):
    """Older Windows, a preamble, decimal commas, minutes, a temperature, n.a. and ---."""
    lines = ["Prüfstand RR-2;Software 4.1.7", f"Probe;{name};Werkstoff;PEEK-CF", "Last / N;1130",
             "Drehzahl / 1/min;60", "", "t / min;Verschleiß / µm;M / N m;T / °C"]  # fmt: skip
    for i, (hour, one, torque) in enumerate(zip(hours, depths, torques, strict=True)):
        depth_cell = "---" if i % 211 == 100 else comma(one, 2)
        torque_cell = "n.a." if i % 307 == 50 else comma(torque, 3)
        warmth = comma(22.0 + 33.0 * (1.0 - np.exp(-hour / 0.8)), 1)
        lines.append(f"{comma(60.0 * hour, 1)};{depth_cell};{torque_cell};{warmth}")
    return "\r\n".join([*lines, ""]).encode("cp1252")


def _lab_b(name, hours, depths, torques):
    """Comments, ISO stamps over midnight, decimal points, repeated stamps, an hour without."""
    lines = ["# tribometer export v3", f"# sample: {name}; load 1130 N; 60 rpm",
             "timestamp,wear [µm],friction torque [Nm]"]  # fmt: skip
    begin = datetime(2026, 3, 14, 8, 15)
    for i, (hour, one, torque) in enumerate(zip(hours, depths, torques, strict=True)):
        if 7.0 < hour < 8.05:
            continue
        stamp = begin + timedelta(hours=float(hour))
        line = f"{stamp:%Y-%m-%d %H:%M:%S},{one:.2f},{torque:.3f}"
        lines += [line] * (2 if i % 250 == 200 else 1)
    return "\n".join([*lines, ""]).encode()


def _lab_c(name, hours, depths, torques):
    """A mark, tabs, stamps with dots, a position in mm that falls, N mm, empty cells."""
    lines = ["\ufeffDatum/Uhrzeit\tWeg / mm\tReibmoment / Nmm"]
    begin = datetime(2026, 3, 17, 17, 40, 30)
    for i, (hour, one, torque) in enumerate(zip(hours, depths, torques, strict=True)):
        stamp = begin + timedelta(hours=float(hour))
        place = "" if i % 199 == 150 else comma(12.498 - 1e-3 * one, 5)
        lines.append(f"{stamp:%d.%m.%Y %H:%M:%S}\t{place}\t{1e3 * torque:.0f}")
    return "\n".join([*lines, ""]).encode()


def _lab_d(name, hours, depths, torques):
    """Clock times, units behind underscores, an offset."""
    lines = ["time;depth_um;torque_Nm"]
    for hour, one, torque in zip(hours, depths, torques, strict=True):
        minutes = round(60.0 * hour)
        lines.append(f"{minutes // 60}:{minutes % 60:02d}:00;{one - 1.9:.2f};{torque:.3f}")
    return "\n".join([*lines, ""]).encode()
