"""Files of other programs, read through a layout: a TOML description of their keys and axes."""
