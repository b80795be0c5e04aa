"""The simulated bench over the devices' wire protocols, in separate processes.

`ur`, `gripper` and `mjpeg` serve one device each and are independent of each other; `host` starts them all.
Nothing here imports a driver. Simulator and drivers both follow the makers' documents, so that an error in
one cannot cancel an error in the other.
"""
