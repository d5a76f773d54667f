"""What a case, a state and a step may be for the physics to hold."""
