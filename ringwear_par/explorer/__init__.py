"""``ringwear explore``: a page on this machine with sliders, histories computed as they move."""
