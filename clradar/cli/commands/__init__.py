"""The subcommands, one module each with a function `command`."""
