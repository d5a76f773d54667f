"""Wear laws, eq. (4): functions of pressure, those of users, and the wear of a step."""

from ringwear_par.wear.at import LocalState

__all__ = ["LocalState"]
