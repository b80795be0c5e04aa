"""`rig doctor`: checks every device of a bench without moving anything, and gives advice."""
