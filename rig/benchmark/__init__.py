"""What `rig benchmark` measures and prints, a package for each of its tables.

May render its own scenes (`fakes.studio`); everything else it asks of `rig`.
"""
