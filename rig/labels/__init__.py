"""Labels made by people and for people: contact masks as outlines, and angles drawn as lines on a page.

Of `rig` it imports frames, sessions, pages and `rig.tactile.contact`.
"""
