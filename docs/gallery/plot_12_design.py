"""
Plan the next test
==================

Which single test determines both numbers of a wear law best, if the worn profile is measured after
it to 0.1 um? Each candidate has a mean pressure and a duration. Near the threshold of 40 MPa the
ring wears beside its edges only, which tells little about k.
"""

import matplotlib.pyplot as plt
import numpy as np

import ringwear_par as rw

rig = {
    "lower": {"r": [20, 40], "z": [0, 20], "young": "10 GPa", "poisson": 0.3},
    "upper": {"r": [28.5, 31.5], "z": [20, 40], "young": "100 GPa", "poisson": 0.3},
    "contact": {"friction": 0.1},
    "wear": {"lower": {"law": "threshold", "k": 1e-7, "p0": "40 MPa"}},
    "load": {"pressure": "80 MPa", "omega": 3.5},
    "time": {"scheme": "adaptive", "end": "100 s"},
}
profile = {
    "quantity": "profile.lower",
    "r": {"from": 28.0, "to": 32.0, "count": 201},  # mm
    "unit": "um",
    "sd": 0.1,
    "nuisance": {"level": {}, "tilt": {}},
    "exclude": [[28.48, 28.56], [31.44, 31.52]],  # mm: the edges, thinner than the stylus
}
found = rw.design(
    {
        "case": rig,
        "fit": {
            "parameters": {
                "wear.lower.k": {"start": 1e-7, "bounds": [1e-9, 1e-5], "scale": "log"},
                "wear.lower.p0": {"start": 40.0, "bounds": [0.0, 200.0]},
            }
        },
        "experiment": [{"name": "planned", "data": [profile]}],
        "design": {
            "criterion": "A",  # the smallest mean variance
            "vary": {"load.pressure": [30, 100], "time.end": [20, 200]},
            "budget": {"time.end": 200.0},
        },
    }
)
print(found.summary())

# %%
# The standard deviation of k that each test would give:

pressure = np.array([test.keys["load.pressure"] for test in found.candidates])
duration = np.array([test.seconds for test in found.candidates])
figure, axes = plt.subplots(figsize=(4.6, 3.2))
for seconds in (40, 100, 200):
    some = np.isclose(duration, seconds)
    axes.plot(pressure[some], 100.0 * found.single[some, 0] / 1e-7, label=f"{seconds} s")
axes.set_yscale("log")
axes.set_xlabel("mean pressure (MPa)")
axes.set_ylabel("standard deviation of k (%)")
axes.legend()
plt.show()
