"""The most informative next tests."""
