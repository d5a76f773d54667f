"""Wear laws, eq. (4): one file a law; the wear of an implicit step; tests of derivatives."""

from ringwear_par.wear.law import LocalState, WearLaw

__all__ = ["LocalState", "WearLaw"]
