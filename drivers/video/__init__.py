"""Frame sources: the DIGIT and the external camera, over V4L2, MJPEG or from files.

The drivers are `digit.py` and `external_camera.py`. `reader.py` has the reader thread, `stream.py`
decodes raw frames. This package imports only the shared modules of `drivers`.
"""
