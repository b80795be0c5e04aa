"""The real drivers over the wire protocols, in real time: a lift, and events at any moment."""
