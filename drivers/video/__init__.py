"""Frame sources: the DIGIT (`digit.py`) and the external camera, over V4L2, MJPEG or from files."""
