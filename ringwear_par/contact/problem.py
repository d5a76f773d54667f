from ringwear_par.contact.solver import ContactState, WarmStart  # noqa
