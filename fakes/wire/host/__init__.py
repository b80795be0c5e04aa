"""All fakes of a bench on one world, in two processes: controller, gripper and world; and the cameras.

Imports the servers of the other packages of `fakes.wire`, and the devices that draw.
"""
