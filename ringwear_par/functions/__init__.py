"""Histories as functions of numbers of their case, for optimisers, samplers and other programs."""
