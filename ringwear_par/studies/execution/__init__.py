"""Sweeps at work: plans, teams, cases side by side."""
