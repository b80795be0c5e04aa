"""`rig benchmark segmentation`: compare contact masks of networks and image processing with labels."""
