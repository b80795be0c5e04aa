"""All fakes of a bench on one world, in two processes: controller, gripper and world; and the cameras."""
