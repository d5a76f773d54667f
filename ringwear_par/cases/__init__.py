"""Cases: one wear test each, read from TOML tables."""
