"""Exact solutions, and what is computed beside them."""
