"""What is known of a specimen while its test runs: a bank of histories, weighed by readings."""
