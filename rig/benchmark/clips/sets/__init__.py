"""Labels that we measured on public data sets, and hashes of the files that were labelled.

A CSV file per set has a row per label, as `rig label-angle` writes them, with the clip's name and its group.
`NAME_sources.csv` has a row per file of a clip: its use (`video`; `frame`, in order; `background`), path,
number of a video's frame, time in s and SHA-256. The median of the rows `background` is the frame without
contact; a `frame` without a path repeats it.
"""
