"""From a bench file to a bench, real or simulated, and who is asked at it.

The one package that names concrete devices. It imports `rig.config`, and devices real and simulated.
"""
