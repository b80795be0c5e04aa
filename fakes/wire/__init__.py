"""The simulated bench behind the devices' own wire protocols, in processes of its own.

`ur`, `gripper` and `mjpeg` serve a device each and do not know one another; `host` starts them all.
Nothing here imports a driver's code: both sides of a wire are held to the makers' documents, so
that an error in one cannot cancel an error in the other.
"""
