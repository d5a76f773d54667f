"""What looks at histories: balances, validity, stresses, boundaries."""
