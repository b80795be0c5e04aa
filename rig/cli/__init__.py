"""The `rig` command, one file per subcommand; groups of subcommands in packages of their own."""
