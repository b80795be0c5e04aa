"""The real drivers over the wire protocols, in real time: a lift, faults, events at any moment."""
