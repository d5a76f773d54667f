"""Stresses inside bodies, on faces and at interfaces."""
