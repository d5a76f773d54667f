"""Results whose last state is another."""

from dataclasses import replace


def with_last_pressure(result, pressure):
    """Return a result with other contact pressures (n,), MPa, in its last state."""
    last = replace(result.checkpoint.last, pressure=pressure)
    return replace(result, checkpoint=replace(result.checkpoint, last=last))
