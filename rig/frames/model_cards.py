"""The cards of the shipped networks, checked against the files they describe."""

import json
from hashlib import sha256
from typing import Any

from drivers.errors import InputError
from rig.tactile.contact.model_files import MODELS
from rig.tactile.contact.network import SHIPPED


def shipped_cards() -> list[dict[str, Any]]:
    """Return the cards of the shipped networks, each with `shipped`: its file's facts and precision.

    A card is that of `rig train`, and describes a file by its hash. Raises `InputError` where a file is
    not one that its card describes.
    """
    return [_card(name) for name in SHIPPED]


def _card(name: str) -> dict[str, Any]:
    card = json.loads((MODELS / f"{name}.json").read_text(encoding="utf-8"))
    digest = sha256((MODELS / f"{name}.onnx").read_bytes()).hexdigest()
    for precision, facts in card["files"].items():
        if facts["sha256"] == digest:
            return {
                **card,
                "name": name,
                "shipped": {**facts, "file": f"{name}.onnx", "precision": precision},
            }
    raise InputError(f"the shipped network '{name}' is not the one its card describes: install anew")
