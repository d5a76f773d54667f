"""Wear laws, one file each."""
