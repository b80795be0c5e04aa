"""The gripper's fingers: opening by counts, force by current; as measured."""
