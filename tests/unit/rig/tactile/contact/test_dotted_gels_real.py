"""Contact detection on real gels with printed dots, on frames known to be with or without contact."""

from collections import Counter
from itertools import islice
from pathlib import Path

import pytest

from drivers.formats import read_csv_rows
from rig.frames.series import read_frames
from rig.tactile.contact.background import mean_background
from rig.tactile.estimators import choose_estimator
from rig.tactile.sample import State

SPANS = Path(__file__).resolve().parents[4] / "data" / "marker_slip_contacts.csv"


@pytest.mark.long
def test_printed_dots_are_not_reported_as_contact(real_data: Path) -> None:
    folder = real_data / "marker_slip_clips"
    rows = [row for _, row in read_csv_rows(SPANS, ("clip", "first", "last", "contact", "background"))]
    frames: Counter[str] = Counter()
    reported: Counter[str] = Counter()
    for clip in dict.fromkeys(row["clip"] for row in rows):
        spans = [row for row in rows if row["clip"] == clip]
        first, last = int(spans[0]["background_first"]), int(spans[0]["background_last"])
        background = read_frames(folder / spans[0]["background"]).images()
        estimator = choose_estimator("slip").make(mean_background(list(islice(background, first, last + 1))))
        in_contact = [
            estimator.update(frame.image, frame.time.time_ns).state is not State.NO_CONTACT
            for frame in read_frames(folder / clip)
            if frame.image is not None
        ]
        for span in spans:
            answers = in_contact[int(span["first"]) : int(span["last"]) + 1]
            frames[span["contact"]] += len(answers)
            reported[span["contact"]] += sum(answers)
    assert frames == {"no": 2690, "yes": 354}
    assert reported["no"] <= 0.05 * frames["no"]
    assert reported["yes"] >= 0.95 * frames["yes"]
