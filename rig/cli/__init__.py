"""The `rig` command: one file per subcommand or group of related ones, two packages for the large groups.

It may import all of `rig`, and does so inside the functions of a command, so that help is shown at once.
"""
