"""Pages of stored results: one HTML file of a run, a sweep or a fit that needs nothing else."""
