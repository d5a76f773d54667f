"""What a fit says of a case that was not tested: the next specimen, the material, one specimen."""
