"""`rig benchmark` and its subcommands."""
