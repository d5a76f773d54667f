"""What is known of a specimen while its test runs: draws of a fit, weighed by readings."""
