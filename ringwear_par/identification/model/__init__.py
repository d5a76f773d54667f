"""Readings of histories at trial parameters."""
