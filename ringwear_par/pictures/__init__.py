"""Charts of runs, sweeps and fits as data, and what draws them."""
