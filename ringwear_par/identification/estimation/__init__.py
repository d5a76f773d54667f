"""Least squares, searches, intervals, posteriors."""
