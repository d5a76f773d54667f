"""Loops over the rows of arrays, compiled ahead, and loaded without the compiler."""
