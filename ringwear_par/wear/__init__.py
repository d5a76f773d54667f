"""Wear laws, eq. (4): one file a law; the wear of an implicit step; tests of derivatives."""

from ringwear_par.wear.law import WearLaw
from ringwear_par.wear.local_state import LocalState

__all__ = ["LocalState", "WearLaw"]
