"""From measurements to the wear law: fit files, readings of histories, least squares, intervals."""
