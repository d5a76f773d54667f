"""Fit files: parameters, measurements, designs of tests."""
