"""The benchmarks of `rig benchmark`, one package per table.

Renders its own scenes with `fakes.studio`; otherwise it uses only `rig`.
"""
