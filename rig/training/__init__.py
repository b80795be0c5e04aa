"""Training of segmentation networks (extra `train`): data, networks, the loop, export to ONNX.

Imports labels, sessions and what makes simulated lifts; may render its own scenes (`fakes.studio`).
"""
