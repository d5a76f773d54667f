"""Laws of wear, eq. (4) of the paper, and the wear of a time step."""
