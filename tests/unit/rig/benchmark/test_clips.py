"""Labelled clips: reading, scoring, and figures of known estimates."""

import csv
import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from drivers.errors import InputError
from drivers.progress import Display, show_on
from rig.benchmark.clips.labelled import ClipLabel, ClipVersion, ContactSpan, clip_version, read_clips
from rig.benchmark.clips.study import (
    ALL,
    Answers,
    ClipsOptions,
    JudgedLabel,
    measure,
    measure_clip,
    noise_at_rest_deg,
    run_clip,
    score,
    time_and_error,
)
from rig.benchmark.harness import Run, markers
from rig.cli.main import app
from rig.pages.palette import ESTIMATE, SERIES
from rig.tactile.angles import Angles
from rig.tactile.estimators import choose_estimator
from rig.version import version_text
from support.ros_bags import TOPIC, write_bag

Draw = Callable[..., NDArray[np.uint8]]
ROOT = Path(__file__).resolve().parents[4]
GROUPS = ROOT / "rig" / "benchmark" / "clips" / "sets" / "octopi.csv"
COLUMNS = "reference_frame,keyframe,angle_deg,sigma_deg"
SPANS = "first,last,contact\n"
TURN_DEG = [*[0.0] * 10, *np.arange(2.0, 32.0, 2.0)]
LABELS = [(9, 0.0), (14, 10.0), (19, 20.0), (24, 30.0)]


def test_progress_names_clip_and_estimator_and_restarts_only_with_a_name(clips: Path) -> None:
    clip = next(clip for clip in read_clips(clips) if clip.name == "frames_clip")
    shown: list[str | int] = []
    show_on(Display(shown.append, lambda done, total: shown.append(done)))
    try:
        measure_clip([choose_estimator("pca"), choose_estimator("ellipse")], clip)
    finally:
        show_on(None)
    names = [each for each in shown if isinstance(each, str)]
    assert names == [
        "frames_clip, time of findTransformECC", "frames_clip, pca", "frames_clip, ellipse",
        "frames_clip, times of pca by interface",
    ]  # fmt: skip
    for before, now in pairwise(shown):
        assert isinstance(now, str) or isinstance(before, str) or now > before


def judged(
    label_deg: float, angle_deg: float | None, sigma_deg: float | None, held_deg: float = 0.0, s: float = 1.0
) -> JudgedLabel:
    held = held_deg if angle_deg is None else angle_deg
    return JudgedLabel(ClipLabel(5, label_deg, s), angle_deg, sigma_deg, held)


@pytest.fixture(scope="module")
def clips(press: Draw, blank: NDArray[np.uint8], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One clip as frames, one as a video, with true labels."""
    folder = tmp_path_factory.mktemp("clips")
    images = [press(15 + turn, (85, 25), seed=i) for i, turn in enumerate(TURN_DEG)]
    for name in ("frames_clip", "video_clip"):
        clip = folder / name
        clip.mkdir()
        cv2.imwrite(str(clip / "background.png"), blank[..., ::-1])
        (clip / "labels.csv").write_text(labels_text(LABELS))
    (folder / "frames_clip" / "frames").mkdir()
    for i, image in enumerate(images):
        cv2.imwrite(str(folder / "frames_clip" / "frames" / f"{i:03d}.png"), image[..., ::-1])
    times = "".join(f"{i},{i / 60:.5f}\n" for i in range(len(images)))
    (folder / "frames_clip" / "timestamps.csv").write_text("frame,t_s\n" + times)
    writer = cv2.VideoWriter(
        str(folder / "video_clip" / "clip.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 60.0, (240, 320)
    )
    for image in images:
        writer.write(np.ascontiguousarray(image[..., ::-1]))
    writer.release()
    (folder / "groups.csv").write_text("clip,group\nvideo_clip,coded\nframes_clip,clean\n")
    return folder


def labels_text(labels: list[tuple[int, float]], columns: str = COLUMNS) -> str:
    return columns + "\n" + "".join(f"9,{frame},{angle},0.5\n" for frame, angle in labels)


@pytest.mark.heavy
def test_clips_of_frames_and_videos_are_read_with_their_groups(clips: Path) -> None:
    found = read_clips(clips)
    assert [(clip.name, clip.group) for clip in found] == [("frames_clip", "clean"), ("video_clip", "coded")]
    assert all(clip.reference_frame == 9 for clip in found)
    assert [label.frame for label in found[0].labels] == [14, 19, 24]
    assert len(read_clips(clips / "video_clip")) == 1


@pytest.fixture
def labelled_twice_a_second(clips: Path, tmp_path: Path) -> Callable[..., Path]:
    """Returns a function that makes a clip with the given labels; frame 9, at 0.9 s, is the reference."""

    def make(angles_deg: list[float]) -> Path:
        for file in ("frames", "background.png"):
            (tmp_path / file).symlink_to(clips / "frames_clip" / file)
        rows = "".join(f"{frame},{0.1 * frame:.1f}\n" for frame in range(25))
        (tmp_path / "timestamps.csv").write_text("frame,t_s\n" + rows)
        labels = list(zip(range(4, 25, 5), angles_deg, strict=True))
        (tmp_path / "labels.csv").write_text(labels_text(labels))
        return tmp_path

    return make


UP, WRAPPED = (-70.0, 0.0, 75.0, 150.0, 225.0), "labels.csv: the labelled angle is wrapped"
FAR, NEAR = (-95.0, 0.0, 98.0, 190.0, 195.0), (-89.0, 0.0, 89.0, 178.0, 267.0)
KEPT = "may be wrapped: 3 steps of more than 90 degrees (first at 0.900 s), kept"


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("true_deg", "period_deg", "note"),
    [(UP, 180.0, WRAPPED), (UP, 360.0, WRAPPED), (FAR, 1e6, KEPT), (NEAR, 1e6, "")],
)
def test_wrapped_labels_are_unwrapped_and_large_turns_kept_with_a_note(
    labelled_twice_a_second: Callable[..., Path], true_deg: tuple[float, ...], period_deg: float, note: str,
    sign: float, caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    true = [sign * angle for angle in true_deg]
    seen = [(angle + period_deg / 2.0) % period_deg - period_deg / 2.0 for angle in true]
    (clip,) = read_clips(labelled_twice_a_second(seen))
    assert [label.angle_deg for label in clip.labels] == pytest.approx([true[0], *true[2:]])
    assert note in caplog.text
    assert bool(note) == bool(caplog.text)


@pytest.mark.heavy
def test_known_rotations_are_measured(clips: Path) -> None:
    report = measure(ClipsOptions(clips, ["slip", "pca"], limits=True), Run())
    rows = report.tables[1].records
    assert [(row["estimator"], row["clips"]) for row in rows[:4:3]] == [("slip", "all"), ("pca", "all")]
    assert rows[1]["clips"] == "clean"
    slip, pca = rows[0]["score"], rows[3]["score"]
    assert [str(of) for of in (slip.within_3, slip.answered, slip.useful)] == ["100% [61, 100]"] * 3
    assert slip.mean_deg < 1.0
    assert (str(slip.false_rest), str(slip.confidently_wrong)) == ("0% [0, 39]",) * 2
    assert pca.useful is None
    assert float(pca.within_3) == 1.0
    assert {limit.name: limit.met for limit in report.limits}["share of answers within two sigma"]


def test_refused_label_counts_with_the_last_angle() -> None:
    labels = (
        judged(0.5, 0.0, 0.2),
        judged(40.0, 35.5, 1.0, s=2.5),  # within 2 label sigmas, not within 3 degrees
        judged(20.0, None, None, held_deg=18.0),  # refused: not within, though near
        judged(-50.0, None, None),  # refused before any answer: 50 degrees off
    )
    found = score(Answers(labels, (1.0, 3.0), has_sigma=True))
    shares = (found.answered, found.within_3, found.within, found.useful, found.two_sigma)
    assert [str(of) for of in shares] == ["2 of 4", "1 of 4", "2 of 4", "2 of 4", "2 of 2"]
    assert found.mean_deg == pytest.approx((0.5 + 4.5 + 2.0 + 50.0) / 4)
    assert found.mean_small_deg == pytest.approx((0.5 + 2.0) / 2)
    assert found.frame_ms == pytest.approx((2.0, 2.8, 2.98))
    assert judged(10.0, 6.0, 1.0, s=1.5).sigmas_off == pytest.approx(4.0 / np.hypot(1.0, 1.5))


@pytest.mark.parametrize(
    ("label_deg", "angle_deg", "sigma_deg", "wrong", "rest"),
    [
        (40.0, 15.0, 4.0, True, True),
        (-40.0, -15.0, 4.0, True, True),
        (40.0, 15.0, 9.0, False, False),  # its sigma shows that the angle is unknown
        (40.0, 21.0, 4.0, True, False),  # more than half of the rotation is reported
        (9.0, 0.0, 0.1, False, False),  # has hardly turned
        (0.0, 20.0, 1.0, True, False),
        (40.0, 90.0, 1.0, True, False),  # turned too far is no rest
        (40.0, None, None, False, False),
    ],
)
def test_confidently_wrong_and_false_rest_are_counted(
    label_deg: float, angle_deg: float | None, sigma_deg: float | None, wrong: bool, rest: bool
) -> None:
    found = judged(label_deg, angle_deg, sigma_deg)
    assert (found.confidently_wrong, found.false_rest) == (wrong, rest)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("labels", "reference_frame,keyframe,angle_deg\n9,9,0\n", "no column sigma_deg"),
        ("labels", labels_text([]), "line 2 is missing"),
        ("labels", labels_text([(9, 0.0)]), "no label except the reference"),
        ("labels", labels_text([(9, 0.0), (400, 1.0)]), "frames 0 to 24"),
        ("labels", labels_text([(14, 1.0), (14, 2.0)]), "two labels"),
        ("labels", labels_text([(14, 1.0)]) + "8,15,1,1\n", "2 reference frames"),
        ("labels", labels_text([(14, float("nan"))]), "line 2: column angle_deg: 'nan' is not a number"),
        ("labels", COLUMNS + "\n9,x,1,1\n", "line 2: column keyframe: 'x' is not a number"),
        ("labels", COLUMNS + "\n9,12,1,-1\n", "negative"),
        ("contacts", SPANS, "line 2 is missing"),
        ("contacts", SPANS + "3,5,maybe\n", "line 2: contact 'maybe': give yes or no"),
        ("contacts", SPANS + "5,3,no\n", "line 2: frames 5 to 3: the clip has frames 0 to 24"),
        ("contacts", SPANS + "3,25,no\n", "line 2: frames 3 to 25: the clip has frames 0 to 24"),
        ("contacts", SPANS + "-1,3,no\n", "line 2: first '-1': give the number of a frame"),
    ],
)
def test_invalid_labels_and_contacts_are_named(
    clips: Path, tmp_path: Path, name: str, text: str, message: str
) -> None:
    clip = tmp_path / "clip"
    clip.mkdir()
    for file in ("frames", "background.png", "labels.csv"):
        (clip / file).symlink_to(clips / "frames_clip" / file)
    (clip / f"{name}.csv").unlink(missing_ok=True)
    (clip / f"{name}.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_clips(tmp_path)


@pytest.mark.heavy
def test_clip_that_is_a_ros_bag_is_read_as_its_frames(clips: Path, tmp_path: Path) -> None:
    shutil.copytree(
        clips / "frames_clip", tmp_path / "clip", ignore=shutil.ignore_patterns("frames", "times*")
    )
    (files,) = [clip for clip in read_clips(clips) if clip.name == "frames_clip"]
    images, times_ns = list(files.series.images()), [frame.time.time_ns for frame in files.series]
    topics = {TOPIC: images, "/camera/image_raw": images[:1]}
    write_bag(tmp_path / "clip" / "bag", topics, times_ns=times_ns * 2)
    (clip,) = read_clips(tmp_path, topic=TOPIC)
    assert [frame.time.time_ns for frame in clip.series] == times_ns
    assert all(np.array_equal(a, b) for a, b in zip(clip.series.images(), images, strict=True))
    assert clip.labels == files.labels
    done = CliRunner().invoke(app, ["benchmark", "clips", str(tmp_path), "--estimator", "slip"])
    assert "choose one with --topic" in str(done.exception)


def test_folders_without_clips_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such folder"):
        read_clips(tmp_path / "none")
    with pytest.raises(InputError, match=r"no folder in it has a labels\.csv"):
        read_clips(tmp_path)
    (tmp_path / "clip").mkdir()
    (tmp_path / "clip" / "labels.csv").write_text(labels_text(LABELS))
    with pytest.raises(InputError, match="is no clip, it has neither a folder 'frames' nor a video"):
        read_clips(tmp_path)


@pytest.mark.heavy
def test_command_writes_page_json_and_table_and_exits_with_4(clips: Path, tmp_path: Path) -> None:
    begin, end = markers("clips")
    readme = tmp_path / "README.md"
    readme.write_text(f"before\n{begin}\nold\n{end}\nafter\n")
    out = tmp_path / "out"
    arguments = ["benchmark", "clips", str(clips), "--estimator", "slip", "--estimator", "ellipse", "--json"]
    limits = ["--p99-ms", "1000", "--group", "clean"]
    done = CliRunner().invoke(app, [*arguments, *limits, "--out", str(out), "--readme", str(readme)])
    assert done.exit_code == 0, done.output
    figures = json.loads(done.stdout)
    assert figures["estimators"]["slip"]["all"]["labels"] == 6
    assert len(figures["estimators"]["slip"]["clips"]["video_clip"]["by_label"]) == 3
    page = (out / "index.html").read_text()
    assert page.count("<svg") == 3, "a figure per clip, and time against error"
    assert "<svg" in (out / "time_and_error.svg").read_text()
    assert page.count("data:image/jpeg") == 2 * len(LABELS)
    assert json.loads((out / "results.json").read_text()).keys() == figures.keys()
    assert figures["tool_version"] == version_text()
    assert "old" not in readme.read_text()
    assert "| ellipse |" in readme.read_text()
    readme.write_text(f"{begin}\n{end}\n")
    without_out = [*arguments[:-1], *limits, "--mean-deg", "0.0001", "--readme", str(readme)]
    missed = CliRunner().invoke(app, without_out)
    assert missed.exit_code == 4
    assert "| ellipse |" in readme.read_text()
    assert "limit missed: mean error up to 30 degrees" in missed.stderr


def test_each_estimator_has_one_colour_in_all_figures() -> None:
    found = SimpleNamespace(answered=SimpleNamespace(count=1), frame_ms=(1.0, 2.0, 3.0), mean_deg=1.0)
    every = [SimpleNamespace(name=name, groups={ALL: found}) for name in "abcde"]
    _, file = time_and_error(every)  # type: ignore[arg-type]
    assert {colour.light for colour in (ESTIMATE, *SERIES)} <= set(re.findall(r"#[0-9a-f]{6}", file))


@pytest.mark.heavy
def test_only_given_limits_apply_to_user_clips(clips: Path, tmp_path: Path) -> None:
    own = ["benchmark", "clips", str(clips / "frames_clip"), "--estimator", "skeleton"]
    page = tmp_path / "page"
    done = CliRunner().invoke(app, [*own, "--out", str(page)])
    assert done.exit_code == 0, done.output
    for text in (done.output, (page / "index.html").read_text(), (page / "table.md").read_text()):
        assert "Limits" not in text
        assert "limits were kept" not in text
    assert '<span class="simulated">' not in (page / "index.html").read_text()
    judged = CliRunner().invoke(app, [*own, "--limits", "--within", "1.01"])
    assert judged.exit_code == 4
    assert "required at least 1.01" in judged.stderr
    assert "time per frame" not in judged.stderr


@pytest.mark.heavy
def test_table_of_one_clip_names_sensor_version_and_error(clips: Path, tmp_path: Path) -> None:
    clip = shutil.copytree(clips / "frames_clip", tmp_path / "clip")
    (clip / "clip.json").write_text('{"sensor": "D20641", "simulated": false}')
    labels = [(frame, TURN_DEG[frame]) for frame in range(9, 25, 3)]
    (clip / "labels.csv").write_text(labels_text(labels))
    command = ["benchmark", "clips", str(clip), "--estimator", "pca", "--out", str(tmp_path / "unit")]
    assert CliRunner().invoke(app, command).exit_code == 0
    rows = (tmp_path / "unit" / "my_unit.md").read_text().splitlines()
    found = dict(row.strip("| ").split(" | ") for row in rows)
    assert (found["my unit"], found["clip"], found["estimator"]) == ("D20641", "clip", "pca")
    assert found["rig"].startswith(version_text())
    assert found["labels beside the reference"] == "5"
    assert found["largest labelled angle, degrees"] == "30.0"
    mean, low, high = map(float, re.findall(r"[0-9.]+", found["mean error, degrees"]))
    assert 0.0 <= low < mean < high < 3.0
    assert found["labels within 3 degrees"] == "100% [57, 100]"
    assert found["useful (sigma at most 5 degrees)"] == "-", "pca has no sigma"
    assert found["noise at rest (quietest second), degrees"] == "-", "the clip is shorter than a second"


def test_noise_at_rest_is_that_of_the_quietest_whole_second() -> None:
    time_s = np.arange(0.0, 4.0, 0.02)
    rng = np.random.default_rng(0)
    noise = rng.normal(0.0, np.where((time_s > 1.2) & (time_s < 2.6), 0.1, 0.8))
    assert noise_at_rest_deg(Angles(time_s, noise)) == pytest.approx(0.1, rel=0.3)
    noise[60:130:20] = np.nan
    assert noise_at_rest_deg(Angles(time_s, noise)) == pytest.approx(0.8, rel=0.3)
    assert noise_at_rest_deg(Angles(time_s[:40], noise[:40])) is None


@pytest.mark.heavy
def test_contacts_add_two_columns_and_limits(clips: Path, blank: NDArray[np.uint8], tmp_path: Path) -> None:
    clip = shutil.copytree(clips / "frames_clip", tmp_path / "frames_clip")
    (clip / "contacts.csv").write_text(SPANS + "0,4,no\n5,9,yes\n10,24,yes\n")
    for i in range(5):
        cv2.imwrite(str(clip / "frames" / f"{i:03d}.png"), blank[..., ::-1])
    run = run_clip(read_clips(clip)[0], choose_estimator("slip"))
    assert len(run.answers.contact_ms) == 20  # frames without contact do not count
    assert run.score.frame_ms == pytest.approx(np.percentile(run.answers.contact_ms, [50, 90, 99]))
    assert (run.score.empty_as_contact, run.score.held_as_contact) == (0.0, 1.0)
    columns = measure(ClipsOptions(tmp_path, ["pca"]), Run()).tables[1].columns
    assert {"held reported as contact", "ms per frame with contact: median, 90 %, 99 %"} <= set(columns)
    command = ["benchmark", "clips", str(tmp_path), "--estimator", "slip", "--json"]
    done = CliRunner().invoke(app, [*command, "--empty", "0", "--held", "0.9"])
    assert done.exit_code == 0, done.output
    (clip / "contacts.csv").write_text(SPANS + "0,4,yes\n20,24,no\n")
    missed = CliRunner().invoke(app, [*command, "--empty", "0.05", "--held", "0.95"])
    assert missed.exit_code == 4
    assert missed.stderr.count("limit missed") == 2


@pytest.mark.heavy
def test_clip_without_contacts_has_no_contact_columns_and_misses_their_limits(clips: Path) -> None:
    report = measure(ClipsOptions(clips / "frames_clip", ["pca"], empty=0.05, held=0.95), Run())
    assert not any("as contact" in column for column in report.tables[1].columns)
    assert [limit.met for limit in report.limits] == [False, False]


def test_unknown_group_and_version_are_named(clips: Path) -> None:
    with pytest.raises(InputError, match="choose one of clean, coded"):
        measure(ClipsOptions(clips, ["pca"], group="dirty"), Run())
    with pytest.raises(InputError, match="choose one of mirror, flip, reverse"):
        measure(ClipsOptions(clips, ["pca"], augment="mirror,upside"), Run())


def test_halves_are_split_by_object_and_of_equal_size() -> None:
    rows = list(csv.DictReader(GROUPS.read_text(encoding="utf-8").splitlines()))
    halves = [{r["clip"] for r in rows if r["group"] == g} for g in ("development", "validation")]
    assert [len(half) for half in halves] == [12, 12]
    for name in ("hairbrush", "controller", "bread_knife", "pen", "lemon", "rice_spatula"):
        assert sum(any(clip.startswith(name) for clip in half) for half in halves) == 1, name


def test_mirrored_and_flipped_versions_negate_angles_and_mirror_frames_and_background(clips: Path) -> None:
    plain = read_clips(clips / "frames_clip")[0]
    first = next(plain.series.images())
    for version, axis in ((ClipVersion.MIRROR, 1), (ClipVersion.FLIP, 0)):
        found = clip_version(plain, version)
        assert (found.name, found.version) == (f"frames_clip ({version})", version)
        assert [label.angle_deg for label in found.labels] == [-10.0, -20.0, -30.0]
        assert np.array_equal(next(found.series.images()), np.flip(first, axis))
        assert np.array_equal(found.background, np.flip(plain.background, axis))


def test_reversed_version_starts_at_the_last_labelled_frame(clips: Path) -> None:
    plain = replace(
        read_clips(clips / "frames_clip")[0],
        labels=(ClipLabel(14, 10.0, 0.5), ClipLabel(19, 20.0, 0.6), ClipLabel(22, 26.0, 0.5)),
        contacts=(ContactSpan(0, 3, False), ContactSpan(4, 23, True), ContactSpan(24, 24, False)),
    )
    found = clip_version(plain, ClipVersion.REVERSE)
    assert found.reference_frame == 0
    assert [(label.frame, label.angle_deg) for label in found.labels] == [(3, -6.0), (8, -16.0), (13, -26.0)]
    # The last is the former reference, whose line is in the last label already.
    assert [label.sigma_deg for label in found.labels] == pytest.approx([0.6, 0.5, 0.5])
    assert found.contacts == (ContactSpan(0, 18, True), ContactSpan(19, 22, False))
    images, backwards = list(plain.series.images()), list(found.series.images())
    assert len(backwards) == 23
    assert np.array_equal(backwards[0], images[22])
    assert np.array_equal(backwards[22], images[0])
    assert np.diff([frame.time.time_ns for frame in found.series]) == pytest.approx(1e9 / 60, rel=1e-3)
    assert np.array_equal(found.background, plain.background)
    last = clip_version(
        replace(plain, reference_frame=24, labels=(ClipLabel(9, -5.0, 1.0),)), ClipVersion.REVERSE
    )
    assert (last.reference_frame, last.labels) == (0, (ClipLabel(15, -5.0, 1.0),))


@pytest.mark.heavy
def test_augmented_clips_have_a_row_per_version_and_all_count_for_limits(clips: Path) -> None:
    options = ClipsOptions(clips, ["slip"], augment="mirror,flip,reverse", within=0.99)
    report = measure(options, Run())
    table = report.tables[2]
    assert [row["version"] for row in table.records[:5]] == ["all", "plain", "mirror", "flip", "reverse"]
    assert [row["clips"] for row in table.records if row["clips"]] == ["all", "clean", "coded"]
    assert [row["score"].labels for row in table.records[:5]] == [24, 6, 6, 6, 6]
    assert table.records[0]["score"] == report.tables[1].records[0]["score"]
    assert all(float(row["score"].within) == 1.0 for row in table.records)
    assert [limit.met for limit in report.limits] == [True]
    assert table.markdown() in report.section


@pytest.mark.heavy
@pytest.mark.timeout(600)
def test_real_clips_of_the_validation_group_meet_every_limit(real_clips: Path) -> None:
    options = ClipsOptions(real_clips, ["slip"], groups=GROUPS, group="validation", limits=True)
    report = measure(options, Run())
    assert report.tables[1].records[0]["score"].labels == 120
    assert [limit.name for limit in report.limits if not limit.met] == []
