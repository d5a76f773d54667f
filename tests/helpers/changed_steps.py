"""Histories whose steps a test changes."""

from functools import partial

from ringwear_par.history import loop


def change_steps(patch, change):
    """Let histories step by ``change(scheme, block, solver, state, end, pace)``."""
    for name, scheme in loop._SCHEMES.items():
        patch.setitem(loop._SCHEMES, name, partial(change, scheme))
