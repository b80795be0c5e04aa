"""The fit of the reported standard deviation to known errors."""

import numpy as np
import pytest

from rig.benchmark.sigma.samples import KnownError
from rig.benchmark.sigma.study import COVERED, EXPECTED, fit, variances
from rig.tactile.slip.fused_angle import TERMS, coefficients


def drawn(roots: tuple[float, ...], count: int, seed: int = 0) -> list[KnownError]:
    """Errors whose variance has known coefficients."""
    rng = np.random.default_rng(seed)
    terms = np.column_stack([np.ones(count), *(rng.gamma(1.0, 9.0, count) for _ in TERMS[1:])])
    errors = rng.normal(0.0, np.sqrt(terms @ np.square(roots)))
    return [
        KnownError(float(error), 0.0, 0.0, tuple(row))
        for error, row in zip(errors, terms.tolist(), strict=True)
    ]


def test_fit_finds_the_coefficients_of_drawn_errors() -> None:
    roots = (0.5, 1.2, 0.4, 0.2, 0.3)
    errors = drawn(roots, 4000)
    fitted = fit(errors, [])
    found, true = variances(fitted, errors), variances(np.array(roots), errors)
    assert np.median(found / true) == pytest.approx(1.0, abs=0.25)
    assert fitted[1] == max(fitted[1:])


def test_fitted_sigma_covers_the_labels_even_if_some_errors_are_far_off() -> None:
    errors = drawn(EXPECTED, 300)
    far = [KnownError(40.0, 1.0, 0.0, error.terms) for error in errors[:9]]
    labels = [*errors, *far]
    sigma = np.sqrt(variances(fit(labels, []), labels))
    off = np.abs([error.error_deg for error in labels])
    joint = np.hypot(sigma, [error.label_deg for error in labels])
    assert (off <= 2.0 * joint).mean() >= COVERED


def test_shipped_coefficients_are_known_for_all_terms() -> None:
    assert coefficients().shape == (len(TERMS),)
    assert (coefficients() >= 0.0).all()
