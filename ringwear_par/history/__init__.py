"""Contact and wear stepped in time, section 3 of the paper."""
