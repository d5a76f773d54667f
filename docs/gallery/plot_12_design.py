"""
Plan the next test
==================

Which single test determines both numbers of a wear law best, if the worn profile is measured after
it to 0.1 um? Each candidate has a mean pressure and a duration. Near the threshold of 40 MPa the
ring wears beside its edges only, which tells little about k.
"""

import matplotlib.pyplot as plt

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
# The standard deviations that the best tests would give, each of the best duration at its pressure:

tests = sorted(found.designs, key=lambda test: test["experiments"][0]["load.pressure"])
pressure = [test["experiments"][0]["load.pressure"] for test in tests]
figure, axes = plt.subplots(figsize=(4.6, 3.2))
axes.plot(
    pressure, [100.0 * test["sd"]["wear.lower.k"] / 1e-7 for test in tests], "o-", label="k (%)"
)
axes.plot(pressure, [test["sd"]["wear.lower.p0"] for test in tests], "s--", label="p0 (MPa)")
axes.set_yscale("log")
axes.set_xlabel("mean pressure (MPa)")
axes.set_ylabel("standard deviation")
axes.legend()
plt.show()
