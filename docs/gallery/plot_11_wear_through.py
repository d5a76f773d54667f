"""
A coating that wears through
============================

3 um of a hard coating on a soft ring. It is gone first under the edges of the contact, then
inwards, while what is left of it bears more and more of the load.
"""

import matplotlib.pyplot as plt

import ringwear_par as rw

coating = {
    "thickness": "3 um", "young": "100 GPa", "poisson": 0.3,
    "wear": {"law": "threshold", "k": 2e-8},
}  # fmt: skip
case = rw.read_case(
    {
        "lower": {
            "r": [20, 40], "z": [0, 20], "young": "10 GPa", "poisson": 0.3, "layers": [coating],
        },
        "upper": {"r": [28.5, 31.5], "z": [20, 40], "young": "100 GPa", "poisson": 0.3},
        "contact.friction": 0.1,
        "wear.lower": {"law": "threshold", "k": 1e-7},
        "load": {"pressure": "80 MPa", "omega": 3.5},
        "time": {"scheme": "adaptive", "end": "300 s"},
    }
)  # fmt: skip
result = rw.simulate(case)

time = result.histories["time"]
figure, (left, share) = plt.subplots(1, 2, figsize=(6.8, 3.0))
for wanted in (0, 60, 120, 180):  # s
    step = abs(time - wanted).argmin()
    thickness = 1e3 * result.layers["layer_left_lower"][step]
    left.plot(result.line.r, thickness, label=f"{time[step]:.0f} s")
left.set_ylim(bottom=0.0)
left.set_xlabel("distance to axis (mm)")
left.set_ylabel("coating left (\N{MICRO SIGN}m)")
left.legend()
share.plot(time, 100.0 * result.layers["share_through_lower"])
share.set_xlim(0.0, 300.0)
share.set_ylim(0.0, 101.0)
share.set_xlabel("time (s)")
share.set_ylabel("worn through (% of the contact)")
plt.show()
