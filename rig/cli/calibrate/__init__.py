"""`rig calibrate` and its subcommands."""
