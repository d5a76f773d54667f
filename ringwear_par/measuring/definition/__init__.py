"""What is measured: measure files, records, weighings."""
