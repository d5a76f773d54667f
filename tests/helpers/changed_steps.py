"""Histories whose steps a test changes: schemes are loaded once, patches of modules miss them."""

from functools import partial

from ringwear_par.history import loop


def change_steps(patch, change):
    """Let histories step by ``change(step, physics, contacts, state, end)``: step is the scheme."""
    method_of = loop.method_of

    def changed(name):
        method = method_of(name)
        return method._replace(
            scheme=partial(change, method.scheme), within=partial(change, method.within)
        )

    patch.setattr(loop, "method_of", changed)
