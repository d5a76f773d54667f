"""Elastic bodies condensed to their contact line, eq. (5) of the paper."""
