"""The slip rig: the product over the neighbours `protocols`, `fakes` and `calibration`, and `drivers`.

From the top: commands (`cli`), measured figures (`benchmark`), pages and tools that look at sessions
(`report`, `export`, `training`, `doctor`, `calibrate`), experiments, what is measured in a lift, results,
the bench, sessions, configuration, perception. Imports point down only; `pyproject.toml` holds it.
"""
