"""
Scatter of the penetration when k and p0 are uncertain
======================================================

200 histories of the paper's rings whose wear coefficient and threshold are not well known: k within
a factor of 2, p0 between 20 and 60 MPa. ``simulate_all`` steps them side by side.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import qmc

import ringwear_par as rw

base = rw.read_case(
    {
        "lower": {"r": [20, 40], "z": [0, 20], "young": "10 GPa", "poisson": 0.3},
        "upper": {"r": [28.5, 31.5], "z": [20, 40], "young": "100 GPa", "poisson": 0.3},
        "contact.friction": 0.1,
        "wear.lower": {"law": "threshold", "k": 1e-7},
        "load": {"pressure": "80 MPa", "omega": 85 / 24},
        "time": {"scheme": "adaptive", "end": "200 s"},
        "output": {"times": np.arange(10.0, 201.0, 10.0).tolist(), "profiles": "last"},
    }
)
draws = qmc.LatinHypercube(2, seed=1).random(200)
results = rw.simulate_all(
    [
        base.replace({"wear.lower.k": 1e-7 * 4.0 ** (u - 0.5), "wear.lower.p0": 20.0 + 40.0 * v})
        for u, v in draws.tolist()
    ]
)

time = results[0].histories["time"]
fan = 1e3 * np.array([result.histories["penetration"] for result in results])
figure, axes = plt.subplots(figsize=(4.6, 3.2))
for outer, shade in ((5, 0.15), (25, 0.3)):
    low, high = np.percentile(fan, [outer, 100 - outer], axis=0)
    label = f"{100 - 2 * outer} % of histories"
    axes.fill_between(time, low, high, color="C0", alpha=shade, linewidth=0, label=label)
axes.plot(time, np.median(fan, axis=0), label="median")
axes.set_xlim(0.0, 200.0)
axes.set_ylim(bottom=0.0)
axes.set_xlabel("time (s)")
axes.set_ylabel("penetration depth (\N{MICRO SIGN}m)")
axes.legend(loc="upper left")
plt.show()
