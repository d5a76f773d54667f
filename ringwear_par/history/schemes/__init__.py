"""Schemes of time steps: one step and its error."""
