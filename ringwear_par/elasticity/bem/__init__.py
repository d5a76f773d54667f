"""Boundary elements of one body, eq. (5)."""
