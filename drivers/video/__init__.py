"""Sources of frames: the DIGIT and the external camera, over V4L2, MJPEG or files.

`digit.py` and `external_camera.py` are the drivers, `reader.py` the thread that reads, `decode.py`
turns what came into images. Imports the vocabulary of `drivers` alone.
"""
