"""The paper's three folds by object id (Table I): a network is scored on objects it never saw."""

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.errors import InputError, unknown_name


@dataclass(frozen=True, slots=True)
class Fold:
    """Objects to train on, to choose the best epoch by, and to score, by id."""

    name: str
    train: tuple[str, ...]
    validation: tuple[str, ...]
    test: tuple[str, ...]


FOLDS = {
    "D_s1": Fold(
        "D_s1", ("1", "2", "4", "5", "6", "8", "10", "12", "13", "14", "15"), ("7", "9", "11"), ("3", "16")
    ),
    "D_s2": Fold(
        "D_s2", ("1", "2", "3", "4", "6", "7", "10", "11", "12", "13", "16"), ("5", "9", "14"), ("8", "15")
    ),
    "D_s3": Fold(
        "D_s3", ("1", "3", "5", "6", "7", "8", "9", "10", "11", "13", "14"), ("4", "15", "16"), ("2", "12")
    ),
}
"""Castano-Amoros and Gil 2023, Table I."""


def find_fold(name: str) -> Fold:
    """Return a fold by its name, upper and lower case alike. Raises `InputError`."""
    for known, fold in FOLDS.items():
        if known.lower() == name.lower():
            return fold
    raise unknown_name("fold", name, FOLDS)


def check_objects(fold: Fold, present: Sequence[str], where: str) -> None:
    """Raise `InputError` unless training, validation and test objects are among those present."""
    for part, wanted in (("train", fold.train), ("validate", fold.validation), ("test", fold.test)):
        if not set(wanted) & set(present):
            raise InputError(
                f"{where}: no object to {part} with in fold {fold.name} (needs one of {', '.join(wanted)}; "
                f"found {', '.join(sorted(set(present))) or 'none'}): name object folders by their number, "
                "as 07_spam, or choose another --fold"
            )
