"""Training of segmentation networks (extra `train`): data, networks, the loop, export to ONNX."""
