"""The subcommands, each a function by its name, in modules of what belongs together."""
