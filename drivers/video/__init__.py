"""Sources of frames: the DIGIT and the external camera, over V4L2, MJPEG or files.

`reader.py` is the thread that reads, `decode.py` makes images. Imports the vocabulary of `drivers` alone.
"""
