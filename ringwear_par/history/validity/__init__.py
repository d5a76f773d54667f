"""What a case, a state, a step may be for the physics to hold, and the worst that a history met."""
