"""
Von Mises stress under the edges of a contact
=============================================

A hard ring on a soft one at 50 MPa. At first the stress is highest under the sharp edges of the
upper ring; 200 s of wear even out the pressure, and the stress with it.
"""

import matplotlib.pyplot as plt
import numpy as np

import ringwear_par as rw

case = rw.read_case(
    {
        "lower": {"r": [20, 40], "z": [0, 20], "young": "10 GPa", "poisson": 0.3},
        "upper": {"r": [28.5, 31.5], "z": [20, 40], "young": "100 GPa", "poisson": 0.3},
        "contact.friction": 0.1,
        "wear.lower": {"law": "archard", "k": 1e-8},
        "load": {"pressure": "50 MPa", "omega": 3.5},
        "time": {"scheme": "adaptive", "end": "200 s"},
        "output.times": [200],
        "stress": {"grid": {"r": [27, 33], "z": [17, 23], "n": [61, 61]}, "times": "all"},
    }
)
data = rw.simulate(case).to_xarray()

figure, both = plt.subplots(1, 2, figsize=(6.4, 3.2), sharey=True)
levels = np.linspace(0.0, 100.0, 21)
for axes, step in zip(both, data.stress_step, strict=True):
    state = data.sel(stress_step=step)
    drawn = axes.contourf(
        data.grid_r, data.grid_z, state.mises_grid.T, levels, cmap="viridis", extend="max"
    )
    axes.axhline(20.0, color="white", linewidth=0.6)
    axes.set_title(f"{float(state.stress_time):g} s")
    axes.set_xlabel("distance to axis (mm)")
    axes.set_aspect("equal")
both[0].set_ylabel("height (mm)")
figure.colorbar(drawn, ax=both, label="von Mises stress (MPa)")
plt.show()
