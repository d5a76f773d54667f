"""
Fit a wear law to measurements
==============================

Readings of two tests are simulated here with k = 1e-7 /MPa, p0 = 25 MPa and noise of 0.2 um, as of
a displacement transducer. The fit estimates both numbers, with their intervals.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import ringwear_par as rw

rig = {
    "lower": {"r": [20, 40], "z": [0, 20], "young": "10 GPa", "poisson": 0.3},
    "upper": {"r": [28.5, 31.5], "z": [20, 40], "young": "100 GPa", "poisson": 0.3},
    "contact": {"friction": 0.1},
    "wear": {"lower": {"law": "threshold", "k": 1e-7, "p0": "25 MPa"}},
    "load": {"pressure": "80 MPa", "omega": 3.5},
    "time": {"scheme": "adaptive", "end": "150 s"},
}
pressures = {"40 MPa": 40.0, "85 MPa": 85.0}
times = {"output.times": np.arange(2.0, 151.0, 2.0).tolist()}
folder, noise = Path(tempfile.mkdtemp()), np.random.default_rng(1)

tests, experiments = {}, []
for name, pressure in pressures.items():
    truth = rw.simulate(rw.read_case(rig, {"load.pressure": pressure, **times})).histories
    readings = 1e3 * truth["penetration"] + noise.normal(0.0, 0.2, truth["time"].size)
    tests[name] = np.column_stack([truth["time"], readings])
    file = folder / f"{pressure:g}.csv"
    np.savetxt(file, tests[name], delimiter=",", header="time_s,penetration_um", comments="")
    data = {
        "quantity": "penetration",
        "file": str(file),
        "columns": {"time": "time_s", "value": "penetration_um"},
        "sd": 0.2,  # um
    }
    experiments.append({"name": name, "set": {"load.pressure": pressure}, "data": [data]})

found = rw.fit(
    {
        "case": rig,
        "fit": {
            "parameters": {
                "wear.lower.k": {"start": 3e-8, "bounds": [1e-9, 1e-5], "scale": "log"},
                "wear.lower.p0": {"start": 0.0, "bounds": [0.0, 200.0]},
            },
        },
        "experiment": experiments,
    }
)
print(found.summary())

# %%
# The model with these numbers, beside the readings:

fitted = {key: entry["estimate"] for key, entry in found.parameters.items()}
figure, axes = plt.subplots(figsize=(4.6, 3.2))
for number, (name, pressure) in enumerate(pressures.items()):
    model = rw.simulate(rw.read_case(rig, {"load.pressure": pressure, **times, **fitted})).histories
    axes.plot(*tests[name].T, ".", color=f"C{number}", markersize=3, label=f"{name}, read")
    depth = 1e3 * model["penetration"]
    axes.plot(model["time"], depth, color=f"C{number}", label=f"{name}, fitted")
axes.set_xlim(0.0, 150.0)
axes.set_ylim(bottom=0.0)
axes.set_xlabel("time (s)")
axes.set_ylabel("penetration depth (\N{MICRO SIGN}m)")
axes.legend()
plt.show()
