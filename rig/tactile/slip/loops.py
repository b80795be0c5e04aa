"""The compiled loops of the alignment: reading a frame between pixels, weights, equations, steps.

They run some hundred times a frame over a few hundred points. All are in one file, because the cache of a
compiled loop (see `rig.tactile.slip.compiled`) does not notice a change in another. A keyframe is one array,
so that a call hands over few of them, and its points are in an order in which the first third is a sample of
all. Sums are of single precision, within vectors of the processor.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.tactile.slip.compiled import compiled

Values = NDArray[np.float32]
Sums = NDArray[np.float64]

MOST_KEYS = 4
"""Number of keyframes that are kept."""
MOST_POINTS = 304
"""Number of points of each channel of a keyframe; a multiple of the processor's vectors."""
SLOPES, TEXTURE, CURVED = 0, 1, 2
# Rows of a channel: place, square of the template, weight, template (C rows), its derivatives (P times C
# rows). C and P are 2 and 6 for slopes, 3 and 3 for texture. The last row has the weights of slopes alone.
# The most curved points, with the curvature as template, are evidence that the alignment does not use.
X, Y, SQUARE, WEIGHT, FIRST, PLAIN, ROWS = 0, 1, 2, 3, 4, 18, 19
# Facts of a keyframe.
SHARE, MIDDLE_X, MIDDLE_Y, ANGLE, LEVER_X, LEVER_Y, COUNTED, UNIT, OWN, FACTS = 0, 1, 2, 3, 4, 5, 6, 9, 10, 11
# Turn and shift come first among the parameters of slopes; gain and a constant slope along x and y follow.
MOTION, PARAMETERS = 3, 6
GAIN_PRIOR, SLOPE_PRIOR, DAMPING = 1e-3, 10.0, 1e-3
# Robust weights and the normal matrix are computed at the start, in this iteration, and where the steps end.
RENEWED_AFTER = 2
DONE_RAD, DONE_PX = 1e-3, 3e-2
SAME_RAD, SAME_PX = 7e-3, 0.2
"""A start that comes nearer to an earlier fit is not followed further: it would end there too."""
MOST_TURN_STEP_RAD, MOST_STEP_PX = 0.1, 1.5
# A channel is never weighted as if it fitted better than this share of its energy.
LEAST_MISFIT, LEAST_GAIN, MOST_GAIN = 0.02, 0.3, 2.0
LEAST_UNEXPLAINED = 0.1
# The cosine is not known better than this.
LEAST_LOSS = 0.01
# Rows of scratch memory per channel: robust weights, and these times the derivatives.
SCRATCH = 13

At = tuple[float, float, float]
"""Place of the middle of a keyframe's points in a frame, x and y, and its rotation since the keyframe."""


class Keys(NamedTuple):
    """Keyframes. bank: (K, 3, ROWS, N), facts: (K, FACTS). used: which of them, the richest first."""

    bank: Values
    facts: Sums
    used: NDArray[np.int64]


class Planes(NamedTuple):
    """A frame. slopes: (4, h, w). texture: (3, h, w).

    views: (2, 3), of both channels: pixels per work pixel, and an offset in x and y.
    """

    slopes: Values
    texture: Values
    views: Sums


class Grid(NamedTuple):
    """A grid of poses: number of steps to either side, and their sizes. part: every Nth point is used."""

    turns: int
    turn_rad: float
    steps: int
    step_px: int
    part: int


class Plan(NamedTuple):
    """How to align.

    slopes_share: weight of the slopes beside the texture. loss_share: weight of the curvature's missing
    agreement in the rank. channels: 1 for slopes alone. most: iterations, 0 to judge the start. part: every
    Nth point is used.
    """

    slopes_share: float
    loss_share: float
    channels: int
    most: int
    part: int


class Found(NamedTuple):
    """Where an alignment ends: see `rig.tactile.slip.alignment.Fit`."""

    angle_rad: float
    x: float
    y: float
    score: float
    best: float
    loss: float
    rank: float


class _Work(NamedTuple):
    """Memory of an alignment.

    weights: (K, 2, N), of the points. scratch: (K, 2, SCRATCH, N). sums: (K, 2, 2), weight and energy of each
    template. matrices: (K, 2, 6, 6) and offsets: (K, 2, 6), of the equations. fits: (K, 2), correlations.
    """

    weights: Values
    scratch: Values
    sums: Sums
    matrices: Sums
    offsets: Sums
    fits: Sums


@compiled
def _count(facts: Sums, channel: int, part: int) -> int:
    """Return the number of points of a keyframe's channel, of every Nth one."""
    return (int(facts[COUNTED + channel]) + part - 1) // part


@compiled
def _place_points(
    key: Values, shape: tuple[int, int], view: Sums, place: At, rim: int, count: int
) -> tuple[NDArray[np.int32], Values]:
    """Return where a keyframe's points, moved, are in a plane (h, w).

    The index of the pixel left above each, and the weights (4, count) of it and its neighbours right, below,
    and right below; 0 for points outside the plane or less than `rim` pixels inside its border. This is apart
    from the reading, because the compiler vectorises only this part.
    """
    (x, y, angle), scale, width, first = place, view[0], np.int32(shape[1]), np.float32(rim)
    cosine, sine = np.float32(math.cos(angle) * scale), np.float32(math.sin(angle) * scale)
    right, down = np.float32(x * scale + view[1]), np.float32(y * scale + view[2])
    last_x, last_y = np.float32(shape[1] - rim - 1.001), np.float32(shape[0] - rim - 1.001)
    none, one = np.float32(0.0), np.float32(1.0)
    at, parts = np.empty(count, np.int32), np.empty((4, count), np.float32)
    for i in range(count):
        at_x = key[X, i] * cosine + key[Y, i] * sine + right
        at_y = key[Y, i] * cosine - key[X, i] * sine + down
        in_x, in_y = min(max(at_x, first), last_x), min(max(at_y, first), last_y)
        inside = one if at_x == in_x and at_y == in_y else none
        column, row = np.int32(in_x), np.int32(in_y)
        aside, under = in_x - np.float32(column), in_y - np.float32(row)
        both = aside * under
        at[i] = row * width + column
        parts[0, i] = inside * (one - aside - under + both)
        parts[1, i], parts[2, i] = inside * (aside - both), inside * (under - both)
        parts[3, i] = inside * both
    return at, parts


@compiled
def _read(keys: Keys, k: int, channel: int, frame: Planes, place: At, count: int, values: Values) -> None:
    """Read a channel at a keyframe's points, moved, with vectors turned back, into values; 0 outside."""
    key, view = keys.bank[k, channel], frame.views[channel]
    planes, unit = (frame.texture, keys.facts[k, UNIT]) if channel else (frame.slopes, 1.0)
    at, parts = _place_points(key, planes.shape[1:], view, place, 0, count)
    angle = (1 + channel) * place[2]
    back, aslant = np.float32(math.cos(angle) * unit), np.float32(math.sin(angle) * unit)
    third, step, line = np.float32(unit), np.uintp(1), np.uintp(planes.shape[2])
    one, two, three = planes[0].reshape(-1), planes[1].reshape(-1), planes[2].reshape(-1)
    for i in range(count):
        n = np.uintp(at[i])
        a, b, d, e = parts[0, i], parts[1, i], parts[2, i], parts[3, i]
        v = a * one[n] + b * one[n + step] + d * one[n + line] + e * one[n + line + step]
        w = a * two[n] + b * two[n + step] + d * two[n + line] + e * two[n + line + step]
        u = a * three[n] + b * three[n + step] + d * three[n + line] + e * three[n + line + step]
        values[0, i] = v * back - w * aslant
        values[1, i] = v * aslant + w * back
        values[2, i] = u * third


@compiled
def _agreement(key: Values, planes: Values, view: Sums, place: At, count: int) -> float | np.float32:
    """Return the cosine between a keyframe's curvature and that of planes (4, h, w) at its points, moved."""
    at, parts = _place_points(key, planes.shape[1:], view, place, 0, count)
    plane, step, line = planes[3].reshape(-1), np.uintp(1), np.uintp(planes.shape[2])
    product, power, energy = np.float32(0.0), np.float32(1e-20), np.float32(1e-20)
    for i in range(count):
        k = np.uintp(at[i])
        above = parts[0, i] * plane[k] + parts[1, i] * plane[k + step]
        value = above + parts[2, i] * plane[k + line] + parts[3, i] * plane[k + line + step]
        product += value * key[FIRST, i]
        power += value * value
        energy += key[FIRST, i] * key[FIRST, i]
    return product / math.sqrt(power * energy)


@compiled
def self_loss(curved: Values, facts: Sums, slopes: Values, view: Sums, turn: float) -> float | np.floating:
    """Return 1 - cosine of the curvature with itself after a rotation and the shift that hides it best.

    The mean of both directions. An arc that turns about its own centre agrees with itself, so it shows a
    rotation less than its curvature alone.
    """
    cosine, x, y, count = 0.0, 0.0, 0.0, int(facts[COUNTED + CURVED])
    for i in range(count):
        x += curved[X, i] / count
        y += curved[Y, i] / count
    for angle in (turn, -turn):
        # At first their middle does not move.
        at_x = facts[MIDDLE_X] + x - (x * math.cos(angle) + y * math.sin(angle))
        at_y = facts[MIDDLE_Y] + y - (y * math.cos(angle) - x * math.sin(angle))
        best, found = -1.0, _agreement(curved, slopes, view, (at_x, at_y, angle), count)
        while found > best:
            best, from_x, from_y = found, at_x, at_y
            for right, down in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)):
                place = from_x + right, from_y + down, angle
                agreement = _agreement(curved, slopes, view, place, count)
                if agreement > found:
                    found, at_x, at_y = agreement, place[0], place[1]
        cosine += best
    return 1.0 - cosine / 2.0


@compiled
def search_grid(
    key: Values, facts: Sums, plane: Values, view: Sums, pose: Sums, grid: Grid
) -> tuple[float, float, float]:
    """Return angle and point at which the curvature of a frame agrees best, on a grid around a pose.

    Its steps are whole pixels: so the weights of neighbouring pixels are computed once per angle. plane:
    curvature (h, w), with zeros around it that are twice as wide as the grid reaches.
    """
    count, x, y = _count(facts, CURVED, grid.part), 0.0, 0.0
    for i in range(count):
        x += key[X, i] / count
        y += key[Y, i] / count
    # From the tracked point to the middle of the points, which does not move when the grid turns.
    x, y = x - facts[LEVER_X], y - facts[LEVER_Y]
    turn = pose[0] - facts[ANGLE]
    middle_x = pose[1] + x * math.cos(turn) + y * math.sin(turn)
    middle_y = pose[2] + y * math.cos(turn) - x * math.sin(turn)
    best, found = -2.0, (pose[0], pose[1], pose[2])
    flat, step, line = plane.reshape(-1), np.uintp(1), np.uintp(plane.shape[1])
    rim = grid.steps * grid.step_px + 1
    for k in range(-grid.turns, grid.turns + 1):
        turn = pose[0] - facts[ANGLE] + k * grid.turn_rad
        cosine, sine = math.cos(turn), math.sin(turn)
        at_x, at_y = middle_x - (x * cosine + y * sine), middle_y - (y * cosine - x * sine)
        away_x = facts[LEVER_X] * cosine + facts[LEVER_Y] * sine
        away_y = facts[LEVER_Y] * cosine - facts[LEVER_X] * sine
        at, parts = _place_points(key, plane.shape, view, (at_x - away_x, at_y - away_y, turn), rim, count)
        for i in range(-rim + 1, rim, grid.step_px):
            for j in range(-rim + 1, rim, grid.step_px):
                shift, product, power = j * plane.shape[1] + i, np.float32(0.0), np.float32(1e-20)
                for n in range(count):
                    at_n = np.uintp(at[n] + shift)
                    above = parts[0, n] * flat[at_n] + parts[1, n] * flat[at_n + step]
                    value = above + parts[2, n] * flat[at_n + line] + parts[3, n] * flat[at_n + line + step]
                    product += value * key[FIRST, n]
                    power += value * value
                fit = product / math.sqrt(power)
                if fit > best:
                    best, found = fit, (turn + facts[ANGLE], at_x + i, at_y + j)
    return found


@compiled
def weigh(keys: Keys, frame: Planes, rest_share: float, noise_share: float, weights: Values) -> None:
    """Compute the weights of points (K, 2, N): those that fit as if nothing had moved may be the gel's."""
    values = np.empty((3, MOST_POINTS), np.float32)
    share = np.float32(rest_share)
    for k in keys.used:
        facts = keys.facts[k]
        for channel in range(2):
            key, count = keys.bank[k, channel], int(facts[COUNTED + channel])
            _read(keys, k, channel, frame, (facts[MIDDLE_X], facts[MIDDLE_Y], 0.0), count, values)
            mean, out = np.float32(0.0), weights[k, channel]
            for i in range(count):
                mean += key[SQUARE, i]
            noise = np.float32(noise_share * mean / count)
            for i in range(count):
                off = noise
                for c in range(2):
                    off += (values[c, i] - key[FIRST + c, i]) ** 2
                if channel:
                    off += (values[2, i] - key[FIRST + 2, i]) ** 2
                # Odds of a point to turn with the object: those before, times the evidence that it has moved.
                moved = key[WEIGHT, i] * off
                out[i] = moved / (
                    moved + (np.float32(1.0) - key[WEIGHT, i]) * share * key[SQUARE, i] + np.float32(1e-20)
                )


@compiled
def _renew(
    key: Values, work: _Work, k: int, channel: int, values: Values, count: int, misfit: float, gain: float
) -> None:
    """Compute the robust weights of a channel, and its normal matrix and offset with them.

    misfit: weighted sum of the squared residuals, with this gain of the template.
    """
    weights, scratch = work.weights[k, channel], work.scratch[k, channel]
    matrix, offset = work.matrices[k, channel], work.offsets[k, channel]
    components, size = 2 + channel, PARAMETERS - 3 * channel
    first, robust = FIRST + components, scratch[0]
    over, by = np.float32(work.sums[k, channel, 0] / (2.0 * misfit + 1e-20)), np.float32(gain)
    for i in range(count):
        square = (values[0, i] - by * key[FIRST, i]) ** 2 + (values[1, i] - by * key[FIRST + 1, i]) ** 2
        if channel:
            square += (values[2, i] - by * key[FIRST + 2, i]) ** 2
        robust[i] = weights[i] / (np.float32(1.0) + square * over)
    if channel == 0:
        for i in range(count):
            robust[i] *= values[2, i]
    for a in range(size):
        offset[a] = 0.0
        for c in range(components):
            row, sum_ = a * components + c, np.float32(0.0)
            for i in range(count):
                scratch[1 + row, i] = robust[i] * key[first + row, i]
                sum_ += scratch[1 + row, i] * key[FIRST + c, i]
            offset[a] += sum_
        for b in range(a + 1):
            entry = np.float32(0.0)
            for c in range(components):
                row, other = 1 + a * components + c, first + b * components + c
                for i in range(count):
                    entry += scratch[row, i] * key[other, i]
            matrix[a, b] = matrix[b, a] = entry


@compiled
def _products(
    key: Values, weights: Values, values: Values, components: int, count: int
) -> tuple[np.float32, np.float32]:
    """Return the weighted sums of values times template, and of squared values."""
    product, power = np.float32(0.0), np.float32(0.0)
    for c in range(components):
        for i in range(count):
            weighted = weights[i] * values[c, i]
            product += weighted * key[FIRST + c, i]
            power += weighted * values[c, i]
    return product, power


@compiled
def _equations(
    key: Values, work: _Work, k: int, channel: int, values: Values, count: int, renew: bool, pulls: Sums
) -> float | np.float32:
    """Compute pulls (P,), and robust weights and the matrix if `renew`; return the weight of the matrix."""
    scratch, offset = work.scratch[k, channel], work.offsets[k, channel]
    components, size, energy = 2 + channel, PARAMETERS - 3 * channel, work.sums[k, channel, 1]
    product, power = _products(key, work.weights[k, channel], values, components, count)
    gain = 1.0
    if channel:
        gain = min(max(product / energy, LEAST_GAIN), MOST_GAIN)
    misfit = max(power - gain * (2.0 * product - gain * energy), 1e-9 * energy)
    if renew:
        _renew(key, work, k, channel, values, count, misfit, gain)
    share = gain / max(misfit, LEAST_MISFIT * energy)
    for a in range(size):
        pull = np.float32(0.0)
        for c in range(components):
            row = 1 + a * components + c
            for i in range(count):
                pull += scratch[row, i] * values[c, i]
        pulls[a] = share * (pull - gain * offset[a])
    return share * gain


@compiled
def _robust_correlation(key: Values, robust: Values, values: Values, count: int) -> float | np.float32:
    """Return the correlation of the slopes with the template, with robust weights."""
    product, power, energy = np.float32(0.0), np.float32(1e-20), np.float32(1e-20)
    for i in range(count):
        fit = values[0, i] * key[FIRST, i] + values[1, i] * key[FIRST + 1, i]
        square = values[0, i] * values[0, i] + values[1, i] * values[1, i]
        product += robust[i] * fit
        power += robust[i] * square
        energy += robust[i] * key[SQUARE, i]
    return product / math.sqrt(power * energy)


@compiled
def _eliminate(matrix: Sums, pulls: Sums) -> None:
    """Eliminate gain and constant slope of the slopes from their equations (6 x 6): the Schur complement."""
    for a in range(PARAMETERS):
        matrix[a, a] += DAMPING * matrix[a, a] + 1e-9
    matrix[3, 3] += GAIN_PRIOR
    matrix[4, 4] += SLOPE_PRIOR
    matrix[5, 5] += SLOPE_PRIOR
    for e in range(PARAMETERS - 1, MOTION - 1, -1):
        for a in range(e):
            factor = matrix[a, e] / matrix[e, e]
            for b in range(e):
                matrix[a, b] -= factor * matrix[e, b]
            pulls[a] -= factor * pulls[e]


@compiled
def _solve(matrix: Sums, pulls: Sums) -> tuple[float, float, float]:
    """Solve three symmetric equations in turn and point."""
    a, b, c = matrix[1, 1], matrix[1, 2], matrix[2, 2]
    p, q, determinant = matrix[0, 1], matrix[0, 2], a * c - b * b + 1e-12
    left = matrix[0, 0] - (p * (c * p - b * q) + q * (a * q - b * p)) / determinant
    pull = pulls[0] - (p * (c * pulls[1] - b * pulls[2]) + q * (a * pulls[2] - b * pulls[1])) / determinant
    turn = pull / (left + 1e-9)
    right, down = pulls[1] - p * turn, pulls[2] - q * turn
    return turn, (c * right - b * down) / determinant, (a * down - b * right) / determinant


@compiled
def _add(
    matrix: Sums, pulls: Sums, share: float, turn: float, facts: Sums, normal: Sums, pulled: Sums
) -> None:
    """Add a keyframe's equations in rotation and shift to those in angle and point, `normal` and `pulled`."""
    cosine, sine, x, y = math.cos(turn), math.sin(turn), facts[LEVER_X], facts[LEVER_Y]
    # The columns of the basis are (1, -y, x), (0, cosine, sine), (0, -sine, cosine).
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 1], matrix[1, 2], matrix[2, 2]
    m, n = e * x - d * y, f * x - e * y
    p, q, both = b + m, c + n, cosine * sine
    normal[0, 0] += share * (a - b * y + c * x - y * p + x * q)
    normal[0, 1] += share * (p * cosine + q * sine)
    normal[0, 2] += share * (q * cosine - p * sine)
    normal[1, 1] += share * (d * cosine * cosine + 2.0 * e * both + f * sine * sine)
    normal[2, 2] += share * (d * sine * sine - 2.0 * e * both + f * cosine * cosine)
    normal[1, 2] += share * ((f - d) * both + e * (cosine * cosine - sine * sine))
    pulled[0] += pulls[0] - y * pulls[1] + x * pulls[2]
    pulled[1] += cosine * pulls[1] + sine * pulls[2]
    pulled[2] += cosine * pulls[2] - sine * pulls[1]


@compiled
def _at(facts: Sums, angle: float, x: float, y: float) -> At:
    """Return where a keyframe is at a pose."""
    turn = angle - facts[ANGLE]
    cosine, sine = math.cos(turn), math.sin(turn)
    at_x = x - (cosine * facts[LEVER_X] + sine * facts[LEVER_Y])
    return at_x, y - (cosine * facts[LEVER_Y] - sine * facts[LEVER_X]), turn


@compiled
def _sum_templates(keys: Keys, work: _Work, plan: Plan) -> None:
    """Compute the weight and the energy of each template."""
    for k in keys.used:
        for channel in range(plan.channels):
            total, energy, key = np.float32(1e-20), np.float32(1e-20), keys.bank[k, channel]
            row = work.weights[k, channel]
            for i in range(_count(keys.facts[k], channel, plan.part)):
                total += row[i]
                energy += row[i] * key[SQUARE, i]
            work.sums[k, channel, 0], work.sums[k, channel, 1] = total, energy


@compiled
def _step(keys: Keys, frame: Planes, work: _Work, plan: Plan, pose: At, renew: bool) -> At:
    """Return the step in angle and point from a pose. renew: whether to compute robust weights, matrices."""
    values, scaled, pulls = np.empty((3, MOST_POINTS), np.float32), np.zeros((6, 6)), np.zeros(6)
    normal, pulled = np.zeros((3, 3)), np.zeros(3)
    for k in keys.used:
        facts = keys.facts[k]
        place = _at(facts, pose[0], pose[1], pose[2])
        for channel in range(plan.channels):
            key, count = keys.bank[k, channel], _count(facts, channel, plan.part)
            _read(keys, k, channel, frame, place, count, values)
            share = _equations(key, work, k, channel, values, count, renew, pulls)
            matrix = work.matrices[k, channel]
            if channel == 0:
                for a in range(PARAMETERS):
                    pulls[a] *= plan.slopes_share
                    for b in range(PARAMETERS):
                        scaled[a, b] = plan.slopes_share * share * matrix[a, b]
                _eliminate(scaled, pulls)
                matrix, share = scaled, 1.0
            for a in range(MOTION):
                pulls[a] *= facts[SHARE]
            _add(matrix, pulls, facts[SHARE] * share, place[2], facts, normal, pulled)
    turn, right, down = _solve(normal, pulled)
    turn = min(max(turn, -MOST_TURN_STEP_RAD), MOST_TURN_STEP_RAD)
    right = min(max(right, -MOST_STEP_PX), MOST_STEP_PX)
    return turn, right, min(max(down, -MOST_STEP_PX), MOST_STEP_PX)


@compiled
def _correlate(keys: Keys, frame: Planes, work: _Work, plan: Plan, pose: At) -> None:
    """Compute the correlation of each channel with its templates at a pose, `work.fits`.

    The slopes alone are correlated with the robust weights of the last step.
    """
    values = np.empty((3, MOST_POINTS), np.float32)
    for k in keys.used:
        place = _at(keys.facts[k], pose[0], pose[1], pose[2])
        for channel in range(plan.channels):
            key, count = keys.bank[k, channel], _count(keys.facts[k], channel, plan.part)
            _read(keys, k, channel, frame, place, count, values)
            if plan.channels == 1:
                work.fits[k, channel] = _robust_correlation(key, work.scratch[k, channel, 0], values, count)
                continue
            weights, energy = work.weights[k, channel], work.sums[k, channel, 1]
            product, power = _products(key, weights, values, 2 + channel, count)
            work.fits[k, channel] = product / math.sqrt(power * energy + 1e-30)


@compiled
def _judge(keys: Keys, frame: Planes, work: _Work, plan: Plan, pose: At) -> Found:
    """Return how well the keyframes fit at a pose, whose correlations are known."""
    score, best, lacks, heavy, loss, most_own = 0.0, 0.0, 0.0, 1e-12, 0.0, -1.0
    for k in keys.used:
        facts = keys.facts[k]
        heavy += facts[SHARE]
        best = max(best, work.fits[k, 0])
        for channel in range(plan.channels):
            fit = max(work.fits[k, channel], 0.0)
            score -= 0.5 * facts[SHARE] * math.log(max(1.0 - fit * fit, LEAST_UNEXPLAINED))
        place, count = _at(facts, pose[0], pose[1], pose[2]), int(facts[COUNTED + CURVED])
        lack = 1.0 - _agreement(keys.bank[k, CURVED], frame.slopes, frame.views[SLOPES], place, count)
        lacks += facts[SHARE] * lack
        if facts[OWN] > most_own:
            most_own = facts[OWN]
            loss = max(lack, LEAST_LOSS) / max(most_own, LEAST_LOSS)
    rank = (score - plan.loss_share * lacks) / heavy
    return Found(pose[0], pose[1], pose[2], score / heavy, best, loss, rank)


@compiled
def align(
    keys: Keys, frame: Planes, weights: Values, scratch: Values, starts: Sums, plan: Plan
) -> tuple[Found, float]:
    """Align a frame to keyframes jointly, from several starts (S, 3).

    Return where the rank is highest, and the rank from the first start. The starts are overwritten with their
    ends. At an end, robust weights that are computed there ask for no further step: with those of the start,
    the end would lie nearer to the start. weights: (K, 2, N). scratch: (K, 2, SCRATCH, N).
    """
    work = _Work(
        weights, scratch, np.empty((MOST_KEYS, 2, 2)), np.zeros((MOST_KEYS, 2, 6, 6)),
        np.zeros((MOST_KEYS, 2, 6)), np.zeros((MOST_KEYS, 2)),
    )  # fmt: skip
    _sum_templates(keys, work, plan)
    found, first = Found(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1e9), 0.0
    for s in range(len(starts)):
        angle, x, y = starts[s, 0], starts[s, 1], starts[s, 2]
        iteration, last, same, still = 0, plan.most == 0, False, False
        while not (same or last):
            renew = iteration == 0 or iteration == RENEWED_AFTER or still
            turn, right, down = _step(keys, frame, work, plan, (angle, x, y), renew)
            angle, x, y = angle + turn, x + right, y + down
            iteration += 1
            for end in starts[:s]:
                same |= abs(end[0] - angle) < SAME_RAD and abs(end[1] - x) + abs(end[2] - y) < SAME_PX
            still = abs(turn) < DONE_RAD and abs(right) + abs(down) < DONE_PX
            last = (still and renew) or iteration >= plan.most
        starts[s, 0], starts[s, 1], starts[s, 2] = angle, x, y
        if same:
            continue
        _correlate(keys, frame, work, plan, (angle, x, y))
        judged = _judge(keys, frame, work, plan, (angle, x, y))
        if s == 0:
            first = judged.rank
        if judged.rank > found.rank:
            found = judged
    return found, first
