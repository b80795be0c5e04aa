"""The `rig` command, one file per subcommand; groups of subcommands in packages of their own.

May import all of `rig`, and does so when a command runs, so that help comes at once.
"""
