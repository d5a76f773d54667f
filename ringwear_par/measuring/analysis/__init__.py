"""From records and weighings to numbers with uncertainties; no model of the contact."""
