"""
A schedule of load and speed
============================

The drive starts, stops and starts again; then the load is taken off and put on again. Tables in
time are straight between their points, and steps end where they bend.
"""

import matplotlib.pyplot as plt
import numpy as np

import ringwear_par as rw

pressure = [[0, 80], [120, 80], [122, 0], [140, 0], [142, 100]]  # s, MPa
omega = [[0, 0], [1, 3.54], [60, 3.54], [61, 0], [80, 0], [81, 3.54]]  # s, rad/s
case = rw.read_case(
    {
        "lower": {"r": [20, 40], "z": [0, 20], "young": "10 GPa", "poisson": 0.3},
        "upper": {"r": [28.5, 31.5], "z": [20, 40], "young": "100 GPa", "poisson": 0.3},
        "contact.friction": 0.1,
        "wear.lower": {"law": "threshold", "k": 1e-7},
        "load": {"pressure": pressure, "omega": omega},
        "time": {"scheme": "adaptive", "end": "200 s"},
        "output.times": np.arange(1.0, 201.0).tolist(),
    }
)
result = rw.simulate(case)
told = result.histories

figure, (top, middle, bottom) = plt.subplots(3, figsize=(4.6, 4.8), sharex=True)
top.plot(told["time"], told["force"] / 1e3)
top.set_ylabel("force (kN)")
middle.plot(told["time"], np.interp(told["time"], *np.transpose(omega)))
middle.set_ylabel("speed (rad/s)")
bottom.plot(told["time"], 1e3 * told["approach"], label="approach of the rings")
bottom.plot(told["time"], 1e3 * told["worn_volume_lower"] / case.area, label="worn, in the mean")
bottom.set_ylabel("depth (\N{MICRO SIGN}m)")
bottom.set_xlabel("time (s)")
bottom.legend(loc=(0.02, 0.32))
for axes in (top, middle, bottom):
    axes.set_xlim(0.0, 200.0)
    axes.set_ylim(bottom=0.0)
plt.show()
