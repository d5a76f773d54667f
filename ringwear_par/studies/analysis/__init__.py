"""Surrogates and sensitivity indices of sweeps."""
