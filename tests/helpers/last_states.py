"""Results whose last state is another."""

from dataclasses import replace


def with_last_pressure(result, pressure):
    """Return a result with other contact pressures (n,), MPa, in its last state."""
    start = result.checkpoint.start
    contact = replace(start.state.contact, pressure=pressure[None])
    start = replace(start, state=replace(start.state, contact=contact))
    return replace(result, checkpoint=replace(result.checkpoint, starts=start, place=0))
