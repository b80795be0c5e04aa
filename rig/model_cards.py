"""The cards of the shipped networks, checked against the files they describe."""

import json
from hashlib import sha256
from typing import Any

from drivers.errors import InputError
from rig.tactile.network import MODELS, SHIPPED


def shipped_cards() -> list[dict[str, Any]]:
    """Return the cards of the shipped networks. Raises `InputError` where a file is not the one described."""
    return [_card(name) for name in SHIPPED]


def _card(name: str) -> dict[str, Any]:
    card = json.loads((MODELS / f"{name}.json").read_text(encoding="utf-8"))
    if sha256((MODELS / f"{name}.onnx").read_bytes()).hexdigest() != card["shipped"]["sha256"]:
        raise InputError(f"the shipped network '{name}' is not the one its card describes: install anew")
    return card
