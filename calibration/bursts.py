"""Times that several samples or frames share: bursts of a serial adapter or a network card, or rounding.

A device that delivers n samples at once gives all of them the time of the read.
"""

import numpy as np
from numpy.typing import NDArray

Times = NDArray[np.int64]

SAME_NS = 100_000
"""Samples within this interval share one time; a stream of 5 kHz keeps all of its times."""
MOST_SHARED = 0.5
"""Fraction of the samples that share their time with another one, from which on the times are those of
bursts."""
_UNEVEN = 0.5
"""Standard deviation of the number of samples per time, over its mean, above which bursts are not regular."""


def spread_bursts(times_ns: Times, copied: NDArray[np.bool_] | None = None) -> tuple[Times, float] | None:
    """Return times (N,) ns in which regular bursts are spread, and the interval of the bursts in s, else 0.

    The samples of a burst came evenly since the burst before, in their order. times_ns: sorted. copied: (N,)
    samples that are copies of the one before: times that these share are returned unchanged. None for
    irregular bursts.
    """
    begins = np.flatnonzero(np.diff(times_ns, prepend=times_ns[:1] - 10 * SAME_NS) > SAME_NS)
    sizes = np.diff(begins, append=len(times_ns))
    same = copied is not None and bool((copied[1:] & (np.diff(times_ns) <= SAME_NS)).any())
    if same or len(begins) < 3 or sizes[sizes > 1].sum() < MOST_SHARED * len(times_ns):
        return times_ns, 0.0
    if sizes.std() > _UNEVEN * sizes.mean():
        return None
    stamps = times_ns[begins]
    usual_ns = float(np.median(np.diff(stamps)))
    since_ns = np.minimum(np.diff(stamps, prepend=stamps[0]), 1.5 * usual_ns)
    shares = np.minimum(sizes[[0, -1]] / float(np.median(sizes)), 1.0)  # the first and last are incomplete
    since_ns[0], since_ns[-1] = usual_ns * shares[0], since_ns[-1] * shares[1]
    stamps[-1] = min(stamps[-1], stamps[-2] + round(since_ns[-1]))
    later = np.repeat(begins + sizes - 1, sizes) - np.arange(len(times_ns))  # in the same burst
    spread = np.repeat(stamps, sizes) - (np.repeat(since_ns / sizes, sizes) * later).astype(np.int64)
    return spread, usual_ns / 1e9
