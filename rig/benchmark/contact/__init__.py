"""Whether estimators tell a contact from a gel that is empty, on recordings of which that is known.

`marker_slip_contacts.csv` names frames of 12 public clips of a GelSight Mini with printed dots, looked at
one by one: those that clearly hold something and those that clearly hold nothing. Frames in between, and
clips in which the gel is never empty, are left out. The background is of another recording with the same gel,
as dots do not come to rest where they were.
"""
