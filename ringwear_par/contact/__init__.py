"""Unilateral contact, eq. (3) of the paper."""
