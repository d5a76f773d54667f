"""Contact pairs and compliances of cases."""
