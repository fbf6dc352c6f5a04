"""Options that subcommands share, in groups."""
