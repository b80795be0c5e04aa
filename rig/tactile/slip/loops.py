"""The inner loops of the alignments, compiled: reading a frame between pixels, weights, equations, steps.

They run some hundred times a frame over a few hundred points: NumPy would spend most of that time on being
called. Those that call one another stand in one file, because the cache of a compiled loop (see
`rig.tactile.slip.compiled`) does not notice a change in another.

Places and vectors are complex numbers, x (right) + i y (down). Sums are of double precision.
"""

import cmath
import math

import numpy as np
from numpy.typing import NDArray

from rig.tactile.slip.channel import Channel, Found, JointKey, Values, Weights
from rig.tactile.slip.compiled import compiled

Sums = NDArray[np.float64]

# Turn and shift come first among the parameters of slopes; gain and a constant slope along x and y follow.
# They stay free if the contact separates them from rotation, else small: prior weights of
# gain, in template energy, and of slope, in pixels; of slopes alone, and of slopes and texture together.
MOTION, PARAMETERS = 3, 6
GAIN_PRIOR, SLOPE_PRIOR = 50.0, 20.0
GAIN_PRIOR_TOGETHER, SLOPE_PRIOR_TOGETHER = 1e-3, 10.0
# The weights of the points and the normal matrix are computed twice: at first, and in this iteration.
RENEWED_AFTER = 2
# A step this small is the last one needed: the next would be several times smaller.
DONE_RAD, DONE_PX = 5e-5, 1.5e-3
DONE_TOGETHER_RAD, DONE_TOGETHER_PX = 5e-4, 1.5e-2
DAMPING, MOST_TURN_STEP_RAD, MOST_STEP_PX = 1e-3, 0.1, 1.5
# A channel is never weighted as if it fitted better than this share of its energy. Texture's gain is kept
# within the others.
LEAST_MISFIT, LEAST_GAIN, MOST_GAIN = 0.02, 0.3, 2.0
# So much of the pixels around a place lies in the contact where slopes are seen.
SEEN = 0.5


@compiled
def turning(angle_rad: float) -> complex:
    """Return the factor that turns places and vectors counter-clockwise as seen."""
    return cmath.exp(-1j * angle_rad)


@compiled
def values_at(key: Channel, angle_rad: float, shift_px: complex) -> Values:
    """Return the frame at a keyframe's points, moved, its vectors turned back, (3, N); 0 outside.

    Bilinear. shift_px: of the center.
    """
    planes, values = key.planes, np.zeros((3, len(key.points)), key.template.dtype)
    turn, middle = turning(angle_rad) * key.scale, (key.center + shift_px) * key.scale + key.middle
    cosine, sine = math.cos(key.turns * angle_rad) * key.unit, math.sin(key.turns * angle_rad) * key.unit
    for i in range(len(key.points)):
        place = key.points[i] * turn + middle
        left, above = math.floor(place.real), math.floor(place.imag)
        c, r = int(left), int(above)
        if 0 <= c < planes.shape[1] - 1 and 0 <= r < planes.shape[0] - 1:
            aside, under = place.real - left, place.imag - above
            both = aside * under
            shares = 1.0 - aside - under + both, aside - both, under - both, both
            x, y, third = 0.0, 0.0, 0.0
            for corner in range(4):
                row, column, share = r + corner // 2, c + corner % 2, shares[corner]
                x += share * planes[row, column, 0]
                y += share * planes[row, column, 1]
                third += share * planes[row, column, 2]
            values[0, i], values[1, i] = x * cosine - y * sine, x * sine + y * cosine
            values[2, i] = third * key.unit
    return values


@compiled
def weights_of(key: Channel, rest_share: float, noise_share: float) -> Weights:
    """Return weights by how ill points would fit had nothing moved: what rests counts little.

    rest_share, noise_share: see `rig.tactile.slip.parameters.Texture`.
    """
    values, noise = values_at(key, 0.0, 0j), noise_share * key.squares.mean()
    points = np.full(len(key.points), noise, np.float32)
    for k in range(len(key.template)):
        for i in range(len(points)):
            points[i] += (values[k, i] - key.template[k, i]) ** 2
    total, energy = 1e-20, 1e-20
    for i in range(len(points)):
        points[i] /= points[i] + rest_share * key.squares[i] + 1e-20
        total += points[i]
        energy += points[i] * key.squares[i]
    return Weights(points, total, energy)


def turning_weights_of(key: Channel, turning: Values, rest_share: float, noise_share: float) -> Weights:
    """Return the weights of `weights_of`, multiplied by those of `TextureKey.turning_at`, (N,)."""
    points = weights_of(key, rest_share, noise_share).points * turning
    # As in `weights_of`, no divisor is 0.
    return Weights(points, float(points.sum()) + 1e-20, float((points * key.squares).sum()) + 1e-20)


@compiled
def correlation_at(key: Channel, weights: Weights, angle_rad: float, shift_px: complex) -> float:
    """Return the correlation of the frame with the template at a motion."""
    values = values_at(key, angle_rad, shift_px)
    product, square = 0.0, 0.0
    for k in range(len(key.template)):
        for i in range(len(key.points)):
            weighted = weights.points[i] * values[k, i]
            product += weighted * key.template[k, i]
            square += weighted * values[k, i]
    return product / math.sqrt(square * weights.energy + 1e-30)


@compiled
def normal_matrix(jacobian: Values, points: Values) -> Sums:
    """Return the normal matrix (P, P) of a jacobian (P, C, N) with weights (N,)."""
    size, components, count = jacobian.shape
    matrix, weighted = np.zeros((size, size)), np.empty(count, jacobian.dtype)
    for a in range(size):
        for k in range(components):
            for i in range(count):
                weighted[i] = points[i] * jacobian[a, k, i]
            for b in range(a + 1):
                total = 0.0
                for i in range(count):
                    total += weighted[i] * jacobian[b, k, i]
                matrix[a, b] += total
    for a in range(size):
        for b in range(a):
            matrix[b, a] = matrix[a, b]
    return matrix


@compiled
def with_priors(matrix: Sums, energy: float) -> Sums:
    """Return the normal matrix of slopes alone with the priors of its parameters."""
    total, regular = np.trace(matrix), matrix.copy()
    for a in range(len(matrix)):
        # A direction without information must not make the matrix exactly singular.
        regular[a, a] += 1e-9 * matrix[a, a] + 1e-12 * total + 1e-30
    regular[3, 3] += GAIN_PRIOR * energy
    for a in range(4, len(matrix)):
        regular[a, a] += SLOPE_PRIOR
    return regular


@compiled
def _pulls(jacobian: Values, points: Values, residuals: Values) -> Sums:
    """Return what residuals (3, N) pull each parameter by, (P,). They are weighted by points (N,) here."""
    pulls = np.zeros(len(jacobian))
    for k in range(jacobian.shape[1]):
        for i in range(len(points)):
            residuals[k, i] *= points[i]
        for a in range(len(pulls)):
            total = 0.0
            for i in range(len(points)):
                total += jacobian[a, k, i] * residuals[k, i]
            pulls[a] += total
    return pulls


@compiled
def _bent(key: Channel, points: Values, energy: float, residuals: Values, turned: float) -> float:
    """Return the change of the last turn if the curvature of the dent may change, too.

    The axes of a dent turn without the object if it rolls or its load shifts. The further parameters are the
    slopes of a saddle and of the saddle turned by 45 degrees. residuals: (3, N). points: weights, (N,).
    """
    radius = math.sqrt(np.mean(np.abs(key.points) ** 2)) + 1e-9
    jacobian = np.empty((PARAMETERS + 2, 2, len(points)), key.jacobian.dtype)
    jacobian[:PARAMETERS] = key.jacobian
    jacobian[PARAMETERS, 0], jacobian[PARAMETERS, 1] = key.points.real / radius, -key.points.imag / radius
    jacobian[PARAMETERS + 1, 0], jacobian[PARAMETERS + 1, 1] = (
        -jacobian[PARAMETERS, 1],
        jacobian[PARAMETERS, 0],
    )
    inverse = np.linalg.inv(with_priors(normal_matrix(jacobian, points), energy))
    return (inverse @ _pulls(jacobian, points, residuals.copy()))[0] - turned


@compiled
def align_alone(
    key: Channel, points: Values, energy: float, start: tuple[float, complex], most: int, to_the_end: bool
) -> Found:
    """Align slopes in at most `most` iterations; see `align`. points: weights, (N,). start: angle, shift."""
    angle_rad, shift_px = start
    used, inverse, step = points.copy(), np.zeros((PARAMETERS, PARAMETERS)), np.zeros(PARAMETERS)
    residuals, last_step, answer_rad, answer_px = values_at(key, 0.0, 0j), step, angle_rad, shift_px
    iteration, done = 0, False
    while iteration < most and (to_the_end or not done):
        values = values_at(key, angle_rad, shift_px)
        if not done and (iteration == 0 or iteration == RENEWED_AFTER):
            for i in range(len(points)):
                used[i] = points[i] if values[2, i] >= SEEN else 0.0
            normal = with_priors(normal_matrix(key.jacobian, used), energy)
            inverse = np.ascontiguousarray(np.linalg.inv(normal))
        values[:2] -= key.template
        step = inverse @ _pulls(key.jacobian, used, values.copy())
        shift_px += turning(angle_rad) * complex(step[1], step[2])
        angle_rad += step[0]
        iteration += 1
        if not done:
            residuals, last_step, answer_rad, answer_px = values, step, angle_rad, shift_px
        if not (math.isfinite(angle_rad) and abs(shift_px) <= 2 * max(key.planes.shape[:2])):
            break
        done = done or (abs(step[0]) < DONE_RAD and max(abs(step[1]), abs(step[2])) < DONE_PX)
    bent_rad = _bent(key, used, energy, residuals, last_step[0])
    squares = np.zeros_like(points)
    for k in range(2):
        for a in range(PARAMETERS):
            for i in range(len(points)):
                residuals[k, i] -= last_step[a] * key.jacobian[a, k, i]
        for i in range(len(points)):
            squares[i] += residuals[k, i] ** 2
    further = angle_rad - answer_rad
    gain, noise = last_step[3], inverse[0, 0]
    return Found(answer_rad, answer_px, gain, noise, iteration, done, used, squares, bent_rad, further)


@compiled
def _equations(
    key: Channel,
    weights: Weights,
    angle_rad: float,
    shift_px: complex,
    robust: Values,
    matrix: Sums,
    renew: bool,
) -> tuple[float, float, Sums]:
    """Return by what the matrix is weighted, by what the pulls are, and these, (P,).

    robust, matrix: weights of the points and normal matrix, computed here if `renew`.
    """
    values, components, gain = values_at(key, angle_rad, shift_px), len(key.template), 1.0
    if components == 3:
        gain = 0.0
        for k in range(components):
            for i in range(len(robust)):
                gain += weights.points[i] * values[k, i] * key.template[k, i]
        gain = min(max(gain / weights.energy, LEAST_GAIN), MOST_GAIN)
    misfit, squares = 0.0, np.zeros_like(robust)
    for k in range(components):
        for i in range(len(robust)):
            values[k, i] -= gain * key.template[k, i]
            squares[i] += values[k, i] ** 2
    for i in range(len(robust)):
        misfit += weights.points[i] * squares[i]
    if renew:
        width = 2.0 * misfit / weights.total + 1e-20
        for i in range(len(robust)):
            robust[i] = weights.points[i] / (1.0 + squares[i] / width)
            if components == 2:
                robust[i] *= values[2, i]
        matrix[:] = normal_matrix(key.jacobian, robust)
    share = gain / max(misfit, LEAST_MISFIT * weights.energy)
    return share * gain, share, _pulls(key.jacobian, robust, values)


@compiled
def key_equations(
    slopes: Channel,
    slope_weights: Weights,
    texture: Channel,
    texture_weights: Weights,
    angle_rad: float,
    shift_px: complex,
    shares: tuple[float, float],
    slope_points: Values,
    texture_points: Values,
    by_slopes: Sums,
    by_texture: Sums,
    renew: bool,
) -> tuple[Sums, Sums]:
    """Return the normal matrix (3, 3) and the pulls (3,) of one keyframe in turn and shift.

    Gain and constant slope of the slopes are eliminated by their Schur complement.
    """
    one, along, pulls = _equations(slopes, slope_weights, angle_rad, shift_px, slope_points, by_slopes, renew)
    two, beside, further = _equations(
        texture, texture_weights, angle_rad, shift_px, texture_points, by_texture, renew
    )
    matrix, pulls = shares[0] * one * by_slopes, shares[0] * along * pulls
    matrix[:MOTION, :MOTION] += shares[1] * two * by_texture
    pulls[:MOTION] += shares[1] * beside * further
    for a in range(PARAMETERS):
        matrix[a, a] += DAMPING * matrix[a, a] + 1e-9
    matrix[3, 3] += GAIN_PRIOR_TOGETHER
    matrix[4, 4] += SLOPE_PRIOR_TOGETHER
    matrix[5, 5] += SLOPE_PRIOR_TOGETHER
    others = np.ascontiguousarray(matrix[MOTION:, MOTION:])
    across = np.ascontiguousarray(matrix[MOTION:, :MOTION])
    eliminated = np.linalg.solve(others, across)
    motion = np.ascontiguousarray(matrix[:MOTION, :MOTION]) - across.T @ eliminated
    return motion, pulls[:MOTION] - eliminated.T @ np.ascontiguousarray(pulls[MOTION:])


@compiled
def align_jointly(
    keys: tuple[JointKey, ...],
    start: tuple[float, complex],
    expected_rad: float,
    prior: float,
    shares: tuple[float, float],
    most: int,
) -> tuple[float, complex, Sums, Sums]:
    """Return angle, point, the normal matrix (3, 3) and each keyframe's correlations (K, 2)."""
    angle_rad, point_px = start
    count = len(keys)
    slope_points = np.zeros((count, 1024), np.float32)
    texture_points = np.zeros((count, 1024), np.float32)
    by_slopes, by_texture = np.zeros((count, 6, 6)), np.zeros((count, 3, 3))
    normal, basis = np.zeros((3, 3)), np.zeros((3, 3))
    basis[0, 0] = 1.0
    for iteration in range(most):
        renew = iteration == 0 or iteration == RENEWED_AFTER
        normal[:] = 0.0
        pulls = np.zeros(3)
        for k in range(count):
            key = keys[k]
            if key.weight <= 0.0:
                continue
            turn = angle_rad - key.angle_rad
            factor = turning(turn)
            shift_px = point_px - factor * key.lever_px - key.slopes.center
            matrix, pull = key_equations(
                key.slopes,
                key.slope_weights,
                key.texture,
                key.texture_weights,
                turn,
                shift_px,
                shares,
                slope_points[k, : len(key.slope_weights.points)],
                texture_points[k, : len(key.texture_weights.points)],
                by_slopes[k],
                by_texture[k],
                renew,
            )
            back, arm = factor.conjugate(), 1j * key.lever_px
            basis[1, 0], basis[1, 1], basis[1, 2] = arm.real, back.real, -back.imag
            basis[2, 0], basis[2, 1], basis[2, 2] = arm.imag, back.imag, back.real
            normal += key.weight * (basis.T @ (matrix @ basis))
            pulls += key.weight * (basis.T @ pull)
        normal[0, 0] += prior
        pulls[0] += prior * (expected_rad - angle_rad)
        step = np.linalg.solve(normal, pulls)
        turned = min(max(step[0], -MOST_TURN_STEP_RAD), MOST_TURN_STEP_RAD)
        right = min(max(step[1], -MOST_STEP_PX), MOST_STEP_PX)
        down = min(max(step[2], -MOST_STEP_PX), MOST_STEP_PX)
        angle_rad += turned
        point_px += complex(right, down)
        if abs(turned) < DONE_TOGETHER_RAD and abs(complex(right, down)) < DONE_TOGETHER_PX:
            break
    fits = np.zeros((count, 2))
    for k in range(count):
        key = keys[k]
        if key.weight > 0.0:
            turn = angle_rad - key.angle_rad
            shift_px = point_px - turning(turn) * key.lever_px - key.slopes.center
            fits[k, 0] = correlation_at(key.slopes, key.slope_weights, turn, shift_px)
            fits[k, 1] = correlation_at(key.texture, key.texture_weights, turn, shift_px)
    return angle_rad, point_px, normal, fits
