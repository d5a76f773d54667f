"""Folders of sweeps: blocks of cases, results.h5, cases.csv."""
