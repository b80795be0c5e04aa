"""`rig estimate` on folders, videos and sessions."""

import csv
import io
import json
import re
import subprocess
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.clock import NS_PER_S
from rig.frames import of_session as session_frames
from rig.frames.of_session import SessionSeries
from rig.frames.series import FrameSeries, TimedFrame
from rig.frames.times import FrameTime
from rig.sessions.recorder import seconds_text
from support.command_line import rig
from support.ros_bags import TOPIC, write_bag

Image = NDArray[np.uint8]
Draw = Callable[..., Image]

# Contact comes on frame 2, is full from frame 4 on, has settled in frame 15 and turns from frame 18 on.
GROWTH = {2: 0.5, 3: 0.8}
TURN_DEG = [*[0.0] * 18, *np.arange(2.0, 22.0, 2.0)]


Done = subprocess.CompletedProcess[str]


def estimate(*arguments: object) -> Done:
    return rig("estimate", *arguments)


def rows(done: Done) -> list[dict[str, str]]:
    """Return the printed table."""
    assert done.returncode == 0, done.stderr
    return list(csv.DictReader(io.StringIO(done.stdout)))


def figures_of(*arguments: object) -> dict[str, Any]:
    done = estimate(*arguments, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def refusal(*arguments: object) -> str:
    """Return the message of a command that ends with an error, in one line and without output."""
    done = estimate(*arguments)
    assert (done.returncode, done.stdout) == (2, "")
    return done.stderr.splitlines()[-1].removeprefix("rig: ")


def drawn_frames(press: Draw) -> list[Image]:
    sizes = [None, None] + [(90 * GROWTH.get(i, 1.0), 24 * GROWTH.get(i, 1.0)) for i in range(2, 28)]
    return [
        press(None, seed=i) if size is None else press(15 + turn, size, seed=i)
        for i, (size, turn) in enumerate(zip(sizes, TURN_DEG, strict=True))
    ]


@pytest.fixture(scope="module")
def lift(press: Draw, blank: Image, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with 28 frames, a background and a table of times beside it."""
    base = tmp_path_factory.mktemp("lift")
    (base / "frames").mkdir()
    cv2.imwrite(str(base / "bare.png"), blank[..., ::-1])
    lines = ["frame,t_s"]
    for i, image in enumerate(drawn_frames(press)):
        cv2.imwrite(str(base / "frames" / f"f{i}.png"), image[..., ::-1])
        lines.append(f"f{i}.png,{100 + i / 60:.4f}")
    (base / "times.csv").write_text("\n".join(lines))
    return base


@pytest.mark.heavy
def test_the_table_has_a_row_per_frame_with_times_as_given(lift: Path) -> None:
    done = estimate(
        lift / "frames", "--background", lift / "bare.png", "--timestamps", lift / "times.csv",
        "--estimator", "ellipse",
    )  # fmt: skip
    assert done.stdout.splitlines()[0] == (
        "t_s,angle_deg,sigma_deg,state,rate_deg_s,shift_x_px,shift_y_px,slip"
    )
    assert [row["t_s"] for row in rows(done)] == [f"{100 + i / 60:.4f}" for i in range(28)]
    assert [row["state"] for row in rows(done)][:3] == ["no_contact", "no_contact", "tracking"]
    assert [row["angle_deg"] for row in rows(done)][:2] == ["", ""]
    assert float(rows(done)[-1]["angle_deg"]) == pytest.approx(19, abs=1.5), "mean of 18 and 20"
    assert "28 frames, 26 answered, refused: 2 no_contact" in done.stderr
    assert "0 degrees is at the first frame with an angle in a settled contact" in done.stderr


def test_ends_with_gaps_last_angle_doubts_and_rows_in_short_lines(lift: Path, tmp_path: Path) -> None:
    header, *times = (lift / "times.csv").read_text().splitlines()
    late = [
        f"{name},{float(t_s) + 0.2 * (i >= 20):.4f}"
        for i, (name, t_s) in enumerate(t.split(",") for t in times)
    ]
    (tmp_path / "times.csv").write_text("\n".join([header, *late]))
    done = estimate(
        lift / "frames", "--background", lift / "frames" / "f9.png", "--timestamps", tmp_path / "times.csv",
        "--estimator", "ellipse", "--out", tmp_path / "out.csv",
    )  # fmt: skip
    lines = done.stderr.splitlines()
    name = next(n for n, line in enumerate(lines) if line == f"{lift / 'frames'}: ellipse")
    assert max(len(line) for line in lines[name + 1 : -1]) < 100
    assert lines[-1] == f"28 rows written to {tmp_path / 'out.csv'}"
    text = " ".join(" ".join(lines[name:-1]).split())
    gap = "warning: 1 gap between the frames, the longest 0.217 s, 0.317 s after the first frame"
    order = ("last angle: ", gap)
    places = [text.index(part) for part in order]
    assert places == sorted(places)


@pytest.mark.heavy
def test_zero_is_where_the_contact_has_settled_or_as_chosen(lift: Path) -> None:
    figures = figures_of(lift / "frames", "--background", "first:2")
    assert figures["reference_time_s"] == pytest.approx(18 / 60, abs=1e-5)
    assert figures["samples"][18]["angle_deg"] == 0
    assert (figures["frames"], figures["answered"]) == (28, 26)
    chosen = estimate(
        lift / "frames", "--background", "first:2", "--estimator", "pca", "--fps", 10,
        "--reference-time", 2.7, "--window", 1,
    )  # fmt: skip
    assert float(rows(chosen)[-1]["angle_deg"]) == 0
    assert float(rows(chosen)[5]["angle_deg"]) == pytest.approx(-20, abs=1.5)


@pytest.mark.heavy
def test_without_an_angle_at_the_reference_time_the_first_answer_is_zero(lift: Path) -> None:
    done = estimate(lift / "frames", "--background", "first:2", "--reference-time", "0.0")
    assert [row["state"] for row in rows(done)[:2]] == ["no_contact", "no_contact"]
    assert rows(done)[2]["angle_deg"] == "0.0"
    last, full = rows(done)[-1], rows(done)[9]
    assert float(last["angle_deg"]) - float(full["angle_deg"]) == pytest.approx(20.0, abs=0.5)
    beyond = abs(float(last["angle_deg"]) - 20.0)
    assert beyond < 2 * float(last["sigma_deg"]), "the contact doubled after the zero"
    assert "first later frame with an angle; no_contact at --reference-time 0.0" in done.stderr


def test_rate_shift_and_slip_stand_behind_the_contracts_columns(lift: Path) -> None:
    done = estimate(lift / "frames", "--background", lift / "bare.png")
    assert [row["slip"] for row in rows(done)[:18]] == ["0"] * 18, "not while the contact grows or rests"
    assert rows(done)[-1]["slip"] == "1"
    assert float(rows(done)[-1]["rate_deg_s"]) == pytest.approx(120, rel=0.3), "2 degrees a frame at 60 Hz"
    x, y = ([float(row[name]) for row in rows(done)[17:]] for name in ("shift_x_px", "shift_y_px"))
    assert max(x) - min(x) < 2.0, "it turns about its middle; half a pixel of the work copy"
    assert max(y) - min(y) < 2.0
    assert (rows(done)[18]["shift_x_px"], rows(done)[18]["shift_y_px"]) == ("0.0", "0.0"), "the zero"
    assert [rows(done)[0][name] for name in ("rate_deg_s", "shift_x_px", "slip")] == ["", "", "0"]
    assert re.search(
        r"0 degrees is at the first frame with an angle in a settled contact, 0\.\d+ s after the first frame",
        done.stderr,
    )
    assert re.search(r"\n  slip 0\.3\d+ s after the first frame\n", done.stderr)


@pytest.mark.heavy
def test_the_alarm_is_armed_when_the_lift_begins(lift: Path) -> None:
    for from_s, until_s in ((0.38, 0.43), (0.28, 0.35)):
        slip_s = figures_of(lift / "frames", "--background", lift / "bare.png", "--lift-from", from_s)[
            "slip_s"
        ]
        assert from_s < slip_s < until_s


@pytest.mark.heavy
def test_background_with_contact_is_warned_of_and_table_is_written(lift: Path) -> None:
    done = estimate(lift / "frames", "--background", lift / "frames" / "f9.png", "--json")
    figures = json.loads(done.stdout)
    assert len(figures["samples"]) == 28
    assert any("this background looks like a contact" in warning for warning in figures["warnings"])
    assert "warning: this background looks like a contact" in done.stderr
    assert figures_of(lift / "frames", "--background", lift / "bare.png")["warnings"] == []


@pytest.mark.heavy
def test_default_background_is_the_untouched_opening(press: Draw, tmp_path: Path) -> None:
    untouched = [press(None, seed=100 + i) for i in range(10)]
    for i, image in enumerate([*untouched, *drawn_frames(press)[2:]]):
        cv2.imwrite(str(tmp_path / f"f{i}.png"), image[..., ::-1])
    done = estimate(tmp_path, "--estimator", "ellipse")
    assert "which are alike" in done.stderr
    assert [row["state"] for row in rows(done)[:10]] == ["no_contact"] * 10
    assert float(rows(done)[-1]["angle_deg"]) == pytest.approx(19, abs=3)


def test_json_is_one_object_and_the_table_goes_to_the_file(lift: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "lift.csv"
    figures = figures_of(lift / "frames", "--background", lift / "bare.png", "--out", out)
    assert figures["out"] == str(out)
    assert "samples" not in figures
    assert len(out.read_text().splitlines()) == 29
    assert "is a file; give a folder" in refusal(lift / "frames", "--out", out / "x.csv")


def test_an_unreadable_frame_is_lost_and_the_rest_answered(lift: Path, tmp_path: Path) -> None:
    for file in (lift / "frames").iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "f12.png").write_bytes((tmp_path / "f12.png").read_bytes()[:2000])
    done = estimate(tmp_path, "--background", lift / "bare.png")
    assert (rows(done)[12]["state"], rows(done)[12]["angle_deg"]) == ("lost", "")
    assert rows(done)[13]["state"] in ("tracking", "rekeyed")
    assert rows(done)[13]["angle_deg"]
    assert "warning: 1 frame could not be read" in done.stderr


def test_a_published_script_keeps_its_own_zero(lift: Path) -> None:
    done = estimate(lift / "frames", "--background", "first:2", "--estimator", "pca-published")
    assert [row["angle_deg"] for row in rows(done)[:2]] == ["", ""], "no contact"
    angles = [float(row["angle_deg"]) for row in rows(done)[2:]]
    assert angles[0] == 0, "the window is not full"
    assert min(angles) >= 0
    assert "the zero of the script" in done.stderr
    own = (lift / "frames", "--estimator", "pca-published", "--reference-time", 0.1)
    assert "leave --reference-time out" in refusal(*own)


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--estimator", "nonsense"), "choose one of slip, skeleton"),
        (("--background", "nowhere.png"), "nowhere.png"),
        (("--reference-time", "soon"), "'soon' is not a number: give a time"),
        (("--background", "first:2", "--reference-time", "99"), "the frames run from 0.000000 to 0.450000"),
        (("--background", "first:2", "--lift-from", "99"), "--lift-from 99: the frames run from 0.000000"),
        (("--lift-from", "soon"), "--lift-from 'soon' is not a number: give a time"),
        (("--timestamps", "nowhere.csv"), "nowhere.csv"),
        (("--timestamps", "a.csv", "--fps", "30"), "give one of them"),
        (("--fps", "0"), "not a frame rate"),
    ],
)
def test_invalid_option_value_is_a_one_line_error(
    lift: Path, arguments: tuple[str, ...], message: str
) -> None:
    assert re.search(message, refusal(lift / "frames", *arguments))


@pytest.fixture
def session(press: Draw, blank: Image, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A session of one lift seen by two fingertips, the second from behind."""
    (tmp_path / "session.json").write_text("{}")
    frames = [
        TimedFrame(str(i), FrameTime(f"{i / 60:.6f}", round(i / 60 * 1e9)), image)
        for i, image in enumerate(drawn_frames(press))
    ]
    series = [
        SessionSeries("001", serial, sign, None, blank, FrameSeries(serial, partial(iter, frames)))
        for serial, sign in (("D1", 1), ("D2", -1))
    ]
    monkeypatch.setattr(session_frames, "session_frames", lambda path: (series, ()))
    return tmp_path


@pytest.mark.heavy
def test_a_session_gives_a_table_per_lift_and_sensor_of_the_objects_angle(session: Path) -> None:
    out = session / "angles"
    figures = figures_of(session, "--estimator", "ellipse", "--out", out)
    assert [lift["serial"] for lift in figures["lifts"]] == ["D1", "D2"]
    lines = [(out / f"001_{serial}.csv").read_text().splitlines()[-1] for serial in ("D1", "D2")]
    ends = [line.split(",")[1] for line in lines]
    assert float(ends[0]) == pytest.approx(19, abs=1.5)
    assert float(ends[1]) == -float(ends[0])
    for options, said in (
        ((), "give --out FOLDER"),
        (("--fps", 60, "--out", out), "contains its times"),
        (("--lift-from", 1, "--out", out), "--lift-from out"),
    ):
        assert said in refusal(session, *options)


@pytest.mark.heavy
def test_recording_gives_one_table_of_its_fingertips(one_lift: Path, tmp_path: Path) -> None:
    copied = tmp_path / "copied.mcap"
    copied.write_bytes((one_lift / "lifts" / "001.mcap").read_bytes())
    page = tmp_path / "lift.html"
    done = estimate(copied, "--page", page)
    by_sensor = {
        serial: [row for row in rows(done) if row["sensor"] == serial]
        for serial in ("SIM-D0001", "SIM-D0002")
    }
    assert sum(map(len, by_sensor.values())) == len(rows(done))
    ends = [float([row for row in rows if row["angle_deg"]][-1]["angle_deg"]) for rows in by_sensor.values()]
    assert ends[0] == pytest.approx(ends[1], abs=5.0), "both are the angle of the object"
    text = page.read_text()
    assert "SIMULATED" in text
    assert all(serial in text for serial in by_sensor)


@pytest.mark.heavy
def test_one_sensor_of_a_recording_is_as_in_its_session(one_lift: Path, tmp_path: Path) -> None:
    recording, serial = one_lift / "lifts" / "001.mcap", "SIM-D0002"
    same = ("--sensor", serial, "--estimator", "ellipse")
    assert estimate(recording, *same, "--out", tmp_path / "one.csv").returncode == 0
    assert estimate(one_lift, *same, "--out", tmp_path / "all").returncode == 0
    assert [path.name for path in (tmp_path / "all").iterdir()] == [f"001_{serial}.csv"]
    of_session = (tmp_path / "all" / f"001_{serial}.csv").read_text().splitlines()
    with_sensor = (tmp_path / "one.csv").read_text().splitlines()
    assert [line.removesuffix(f",{serial}") for line in with_sensor[1:]] == of_session[1:]


def test_options_that_do_not_fit_a_recording_or_a_clip_are_refused(one_lift: Path, lift: Path) -> None:
    recording = one_lift / "lifts" / "001.mcap"
    for frames, options, said in (
        (recording, ("--sensor", "D9"), "choose one of SIM-D0001, SIM-D0002"),
        (recording, ("--fps", 60), "contains its times"),
        (recording, ("--topic", "/a"), "leave --topic out, or give --sensor"),
        (lift / "frames", ("--sensor", "D1"), "leave --sensor out"),
        (one_lift, ("--page", "page.html", "--out", "x"), f"rig report {one_lift}"),
    ):
        assert said in refusal(frames, *options), options


@pytest.mark.heavy
def test_page_of_own_frames_shows_curve_states_and_frames(lift: Path, tmp_path: Path) -> None:
    page = tmp_path / "lift.html"
    figures_of(lift / "frames", "--background", lift / "bare.png", "--page", page)
    text = page.read_text()
    assert "estimated angle, with its 2 sigma band" in text
    assert "marker" not in text
    assert text.count("data:image/jpeg;base64,") == 6
    assert "<td>93%</td>" in text
    assert "2 no contact" in text
    assert "SIMULATED" not in text


def test_clip_without_contact_is_named_and_has_a_page(blank: Image, tmp_path: Path) -> None:
    (tmp_path / "clip").mkdir()
    for i in range(10):
        cv2.imwrite(str(tmp_path / "clip" / f"{i}.png"), blank[..., ::-1])
    done = estimate(tmp_path / "clip", "--background", "first:3", "--page", tmp_path / "clip.html")
    assert (done.returncode, "warning: no frame shows a contact" in done.stderr) == (0, True)
    assert "refused" in (tmp_path / "clip.html").read_text()


@pytest.mark.heavy
@pytest.mark.parametrize("storage", ["mcap", "sqlite3", "ros1"])
def test_ros_bag_gives_the_estimates_of_the_same_frames_as_files(
    lift: Path, press: Draw, tmp_path: Path, storage: str
) -> None:
    times_ns = [100 * NS_PER_S + round(i * NS_PER_S / 60) for i in range(28)]
    times = "".join(f"f{i}.png,{seconds_text(time_ns)}\n" for i, time_ns in enumerate(times_ns))
    (tmp_path / "times.csv").write_text(f"frame,t_s\n{times}")
    path = write_bag(tmp_path / "turn.bag", {TOPIC: drawn_frames(press)}, storage, times_ns=times_ns)
    background = ("--background", lift / "bare.png")
    of_bag = estimate(path, *background, "--topic", TOPIC)
    of_files = estimate(lift / "frames", *background, "--timestamps", tmp_path / "times.csv")
    assert of_bag.stdout == of_files.stdout
    assert len(rows(of_bag)) == 28


def test_ros_bag_without_its_topic_ends_with_code_2_and_lists_the_topics(press: Draw, tmp_path: Path) -> None:
    image = press(None, seed=1)
    done = rig("estimate", str(write_bag(tmp_path / "bag", {"/left": [image], "/right": [image]})))
    assert done.returncode == 2
    assert "2 topics of images: choose one with --topic: /left, /right" in done.stderr
