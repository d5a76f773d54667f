"""``ringwear measure``: steady wear rates, friction and their budgets from a rig's own files."""
