"""The live view: what happens on the bench, shown while it happens, without ever being waited for."""
