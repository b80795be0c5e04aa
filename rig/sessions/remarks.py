"""What a person says of a session: a name, a note, tags, who was there. Nothing is measured by it."""

import re
from dataclasses import dataclass, replace
from typing import ClassVar

from pydantic import ConfigDict

from drivers.errors import InputError
from rig.sessions.codec import STRICT

LONGEST_NAME, LONGEST_NOTE, LONGEST_TAG, MOST_TAGS = 80, 2000, 40, 20
_TAG = re.compile(r"\w[\w.+-]*")


@dataclass(frozen=True)
class Remarks:
    """Each is empty where nobody said it."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    name: str = ""
    note: str = ""
    tags: tuple[str, ...] = ()
    operator: str = ""

    def joined(self, later: "Remarks") -> "Remarks":
        """Return these with what was said later: its tags added, its other words instead."""
        words = {key: getattr(later, key) or getattr(self, key) for key in ("name", "note", "operator")}
        return replace(self, **words, tags=tuple(dict.fromkeys((*self.tags, *later.tags))))

    def lines(self) -> list[str]:
        """Say them, a line each, those that are there."""
        said = {"tags": ", ".join(self.tags), "operator": self.operator, "note": self.note}
        return [f"{what}: {text}" for what, text in said.items() if text]


NO_REMARKS = Remarks()


def remarks_of(name: str | None, note: str | None, tags: list[str] | None, operator: str | None) -> Remarks:
    """Return what was typed. Raises `InputError` for what could not be shown on a line."""
    for what, text, longest in (
        ("name", name, LONGEST_NAME), ("note", note, LONGEST_NOTE), ("operator", operator, LONGEST_NAME)
    ):  # fmt: skip
        if text is not None and not (text.strip() and text.isprintable() and len(text) <= longest):
            raise InputError(f"--{what}: give one line of at most {longest} characters")
    kept = tuple(dict.fromkeys(tags or ()))
    for tag in kept:
        if len(tag) > LONGEST_TAG or not _TAG.fullmatch(tag):
            raise InputError(
                f"--tag {tag!r}: a tag is one word, as gel-7, of at most {LONGEST_TAG} characters"
            )
    if len(kept) > MOST_TAGS:
        raise InputError(f"--tag: {len(kept)} tags are more than {MOST_TAGS}")
    return Remarks((name or "").strip(), (note or "").strip(), kept, (operator or "").strip())
