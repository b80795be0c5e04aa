"""The benchmarks of `rig benchmark`, each in a module or package.

Renders its own scenes with `fakes.studio`; otherwise it uses only `rig`.
"""
