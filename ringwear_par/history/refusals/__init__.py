"""What is refused: cases, states and steps of which the physics does not hold.

Reasons that only warn are in ``results/warnings.py``.
"""
