"""Tangent-linear histories: derivatives with respect to numbers of a case."""
