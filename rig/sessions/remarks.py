"""A person's remarks on a session: name, note, tags, operator. They do not affect measurements."""

import re
from dataclasses import dataclass, replace

from drivers.errors import InputError
from rig.sessions.codec import strict

LONGEST_NAME, LONGEST_NOTE, LONGEST_TAG, MOST_TAGS = 80, 2000, 40, 20
"""Limits of the metadata: characters of a name, a note and a tag; number of tags."""
_TAG = re.compile(r"\w[\w.+-]*")


@strict
@dataclass(frozen=True)
class Remarks:
    """Name, note, tags and operator of a session; empty if not given."""

    name: str = ""
    note: str = ""
    tags: tuple[str, ...] = ()
    operator: str = ""

    def joined(self, later: "Remarks") -> "Remarks":
        """Return these with later remarks: tags are added, other texts are replaced."""
        words = {key: getattr(later, key) or getattr(self, key) for key in ("name", "note", "operator")}
        return replace(self, **words, tags=tuple(dict.fromkeys((*self.tags, *later.tags))))

    def lines(self) -> list[str]:
        """Return one line per given remark."""
        texts = {"tags": ", ".join(self.tags), "operator": self.operator, "note": self.note}
        return [f"{what}: {text}" for what, text in texts.items() if text]


NO_REMARKS = Remarks()


def remarks_of(name: str | None, note: str | None, tags: list[str] | None, operator: str | None) -> Remarks:
    """Return the remarks typed by the user. Raises `InputError` for text that does not fit on one line."""
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
