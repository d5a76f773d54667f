"""Unilateral contact, eq. (3) of the paper: the problem, and two solvers that check each other."""
