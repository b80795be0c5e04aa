"""What a session folder holds (contract, session folder): names of its files and folders, said once."""

MANIFEST = "session.json"
RESULTS = {"trial": "lifts.jsonl", "record": "poses.jsonl", "replay": "replays.jsonl"}
"""Where each kind of session keeps its finished work, a line each."""
TIMING = "timing.jsonl"
"""Everything that was measured in time, so that all else is identical for identical seeds."""
LOG = "log.txt"
TRUE_MASKS = "truth/masks"
"""Where the true contacts of simulated images are kept, apart from what the rig sees."""
