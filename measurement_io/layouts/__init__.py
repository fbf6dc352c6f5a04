"""Files of any lab, read through a small TOML description of what is where in them."""
