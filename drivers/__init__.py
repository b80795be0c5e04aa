"""What the bench's hardware can do, and the real devices doing it.

The modules here are the vocabulary that everything above shares: interfaces, values, errors, the
clock, motions, images as bytes, the readers of formats (`formats`), and the count of a source's frames.
The devices stand in packages of their own (`ur5e`, `robotiq_3f`, `video`), which `rig.bench` alone
names. Imports nothing of the rig.
"""
