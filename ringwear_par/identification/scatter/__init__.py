"""Fits of tests whose specimens differ: the values of a material, and how they scatter."""
