"""The `rig` command, one file per subcommand."""
