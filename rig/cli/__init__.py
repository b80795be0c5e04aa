"""The `rig` command: one file per subcommand or group of related ones, two packages for the large groups.

Commands may import all of `rig`. They do so inside their functions, so that `--help` does not wait for it.
"""
