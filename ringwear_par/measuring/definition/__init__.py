"""What is measured: measure files and records."""
