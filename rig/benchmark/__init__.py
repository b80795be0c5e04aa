"""Run time against error, with limits: what `rig benchmark` measures and prints."""
