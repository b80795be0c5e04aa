"""`rig doctor`: looks at every device of a bench without moving anything, and says what to do."""
