"""The live view: what happens on the bench, shown while it happens, without ever being waited for.

Imports a lift's measurement and sessions; it reads them and changes nothing.
"""
