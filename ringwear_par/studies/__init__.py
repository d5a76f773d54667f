"""Ensembles of histories over the ranks."""
