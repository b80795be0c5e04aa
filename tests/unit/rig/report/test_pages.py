"""Reports: content of the pages, and their messages about damaged sessions."""

import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.errors import InputError
from rig.pages.page import asset, environment
from rig.report import explored
from rig.report.charts import angle_range, before_lift, shown_range, useful_share
from rig.report.parts import link_lifts
from rig.report.recording_page import LABEL_PX, THUMB_PX, montage, read_recording
from rig.report.session import Trial, read_trial
from rig.report.strips import FRAMES, moments
from rig.report.trial_page import fingertip_table, object_table, trial_page
from rig.report.write import write_report
from rig.results.summary import summarize_trial
from rig.sessions.manifest import RecordManifest, TrialManifest, read_manifest_of
from rig.sessions.rows import read_finished_lifts
from rig.tactile.angles import FUSED, MARKERS, Angles

UPLOT_SHA256 = "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f"
"""Of dist/uPlot.iife.min.js in uplot-1.6.32.tgz of the npm registry."""


class Page(HTMLParser):
    """What a test wants to know of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.html = path.read_text(encoding="utf-8")
        self.figures: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.images = 0
        self.text = ""
        self.feed(self.html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.links += [given[name] for name in ("src", "href", "xlink:href") if name in given]
        self.images += tag == "img"
        if "id" in given:
            self.ids.append(given["id"])
        if tag == "svg":
            assert given["role"] == "img"
            self.figures.append(given["aria-label"])

    def handle_data(self, data: str) -> None:
        self.text += data


def page_of(session: Path) -> Page:
    return Page(write_report([session]).path)


def read(session: Path) -> Trial:
    return read_trial(session, read_manifest_of(session, TrialManifest, "no trial"))


@pytest.fixture(scope="module")
def trial(drawn_trial: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drawn_trial(tmp_path_factory.mktemp("report") / "session")


@pytest.fixture(scope="module")
def page(trial: Path) -> Page:
    return page_of(trial)


def edited(session: Path, number: int, **changes: Any) -> None:
    rows = [json.loads(line) for line in (session / "lifts.jsonl").read_text().splitlines()]
    rows[number - 1].update(changes)
    (session / "lifts.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))


@pytest.mark.heavy
def test_a_trial_s_page_has_its_figures_and_figures_have_names_of_their_own(page: Page) -> None:
    titles = " ".join(page.figures)
    wanted = "per object,against angle,against rate,over time,Grip and outcome,Onset latency,sigma cover"
    assert [title for title in (*wanted.split(","), "lift 1", "lift 2") if title not in titles] == []
    assert page.images == 2 * 3 * 6  # two lifts, two fingertips and the camera, six moments
    assert "camera CAM, marker angle" in page.text
    assert len(page.ids) == len(set(page.ids))


def test_lifts_are_shown_from_the_beginning_of_phase_a(trial: Path) -> None:
    lift = read(trial).lifts[0]
    times = np.arange(-3.0, 0.0, 0.1)
    tip = Angles(times, np.full(times.size, 0.5), np.full(times.size, 0.1), ("tracking",) * times.size)
    begins_s = {**lift.phases_s, "A": lift.phases_s["B"] - 2.95}
    early = replace(lift, phases_s=begins_s, angles={**lift.angles, "T1": tip})
    assert shown_range(early)[0] == pytest.approx(-2.95)
    ((shown_s, angles_deg),) = before_lift(early)
    assert shown_s.min() > -2.95
    assert set(angles_deg) == {0.5}
    assert angle_range(early)[1] > 0.5


def test_strip_shows_the_largest_error_and_the_whole_lift_if_the_slip_was_caught_at_once(trial: Path) -> None:
    lift = read(trial).lifts[0]
    error = np.zeros(lift.truth.time_s.size)
    worst = int(np.abs(lift.truth.time_s - 0.6).argmin())
    error[worst] = 3.0
    estimate = replace(lift.truth, angle_deg=lift.truth.angle_deg + error)
    slipped = replace(lift, angles={**lift.angles, FUSED: estimate})
    assert lift.truth.time_s[worst] in moments(slipped)
    still = replace(lift.truth, angle_deg=np.zeros(error.size))
    caught = replace(
        slipped, angles={FUSED: replace(still, angle_deg=error), MARKERS: still}, onset_truth_s=0.01
    )
    times_s = moments(caught)
    assert len(times_s) == FRAMES
    assert max(np.diff(times_s)) < 0.5 * (times_s[-1] - times_s[0]), "today's six pictures were at 0.01 s"


def test_page_states_the_share_of_useful_answers_and_explains_an_interval_from_zero(trial: Path) -> None:
    lifts = read(trial).lifts
    vague = replace(lifts[0].estimate, sigma_deg=np.full(len(lifts[0].estimate), 9.0))
    assert useful_share(lifts[1]) == 1.0
    assert useful_share(replace(lifts[0], angles={**lifts[0].angles, FUSED: vague})) == 0.0
    unknown = replace(vague, sigma_deg=np.full(len(vague), np.nan))
    assert useful_share(replace(lifts[0], angles={**lifts[0].angles, FUSED: unknown})) is None
    parts = environment("rig.report").get_template("parts.html").module
    rows = [["mug", f"0.21 \u00b1 0.1 [{low}, 0.93]"] for low in ("0.00", "0.10")]
    texts = [parts.about_interval("the interval", [row]) for row in rows]
    assert ["begins at 0.00" in text for text in texts] == [True, False]


def test_numbers_on_pages_have_a_minus_sign_and_zero_has_none() -> None:
    for text, shown in (
        ("-4.6\u00b0", "\u22124.6\u00b0"), ("-0.0 to -0.04", "0.0 to \u22120.04"), ("[-0.00", "[0.00"),
        ("2026-11-21", "2026-11-21"), ("0-5", "0-5"), ("D-1", "D-1"), ("-", "-"), ("x -1.5", "x \u22121.5"),
        ("rig play s --from -1", "rig play s --from -1"), ("+-1", "+-1"),
    ):  # fmt: skip
        assert environment("rig.report").from_string("{{ text }}").render(text=text) == shown


@pytest.mark.heavy
def test_a_page_needs_nothing_from_elsewhere(page: Page) -> None:
    assert all(link.startswith(("data:", "#")) for link in page.links)
    programs = re.findall(r"<script>.*?</script>", page.html, re.DOTALL)
    assert len(programs) == 2
    program = asset("uplot/uPlot.iife.min.js")
    assert program.startswith("/*! https://github.com/leeoniya/uPlot (v1.6.32) */")
    assert hashlib.sha256(program.encode()).hexdigest() == UPLOT_SHA256
    assert "MIT License" in asset("uplot/LICENSE")
    html = re.sub("|".join(map(re.escape, programs)), "", page.html)
    elsewhere = r"@import|url\((?!#)|<script(?! type=\"application/json\")|<link(?! rel=\"icon\")"
    assert not re.search(rf"{elsewhere}|<script[^>]* src", html)


@pytest.mark.heavy
def test_warnings_and_rows_link_to_the_figure_of_their_lift(page: Page, trial: Path) -> None:
    assert {"lift-1", "lift-2"} <= set(page.ids)
    assert page.links.count("#lift-1") >= 1
    anchors = {"knife, lift 1": "lift-1", "knife, lift 12": "lift-12"}
    text = link_lifts("<b> knife, lift 12 and knife, lift 1, knife, lift 123", anchors)
    assert text == (
        '&lt;b&gt; <a href="#lift-12">knife, lift 12</a> and <a href="#lift-1">knife, lift 1</a>, '
        "knife, lift 123"
    )


def films_of(html: str) -> list[dict[str, Any]]:
    found = re.findall(r'<script type="application/json" id="lift-\d+-data">(.*?)</script>', html)
    return [json.loads(data)["film"] for data in found]


@pytest.mark.heavy
@pytest.mark.usefixtures("quick_figures")
def test_films_have_fewer_pictures_if_the_page_has_no_room_and_the_page_says_so(
    trial: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = read(trial)
    whole = trial_page(session).html
    monkeypatch.setattr(explored, "MOST_BYTES", 0)
    monkeypatch.setattr(explored, "LEAST_FILM_BYTES", 0)
    small = trial_page(session).html
    assert len(small) < len(whole)
    assert [(len(film["times"]), film["about"]) for film in films_of(whole)] == [(24, "")] * 2
    about = "6 of 24 pictures, to keep this page small"
    assert [(len(film["times"]), film["about"]) for film in films_of(small)] == [(6, about)] * 2


@pytest.mark.heavy
def test_page_is_the_same_if_two_processes_read_and_draw_it(page: Page, trial: Path, tmp_path: Path) -> None:
    def lasting(html: str) -> str:  # figures are counted per process
        return re.sub(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC|\bf\d+-", "", html)

    parallel = write_report([trial], tmp_path / "page.html", jobs=2).path.read_text(encoding="utf-8")
    assert lasting(parallel) == lasting(page.html)


@pytest.mark.heavy
def test_page_begins_with_simulated_and_has_the_errors_of_the_session(page: Page, trial: Path) -> None:
    assert 0 < page.text.index("SIMULATED") < page.text.index("MARE")
    rows = [json.loads(line) for line in (trial / "lifts.jsonl").read_text().splitlines()]
    mean = np.mean([row["re"]["mean_deg"] for row in rows])
    assert f"{mean:.2f} ±" in page.text


def test_each_column_of_the_paper_s_table_stands_under_its_heading(trial: Path) -> None:
    rows = read_finished_lifts(trial)
    table = object_table(summarize_trial(rows))
    first = dict(zip(table.columns, table.rows[0], strict=True))
    wanted = {"object": "t1 wrench", "lifts": "2", "outcomes": "2 slipped", "true turn, °": "-20 to +12"}
    assert wanted | {"answered": "100.0%"} == {k: v for k, v in first.items() if "MARE" not in k}
    for heading, part in (("MARE in B, °", "re_b"), ("MARE in B and C, °", "re")):
        assert first[heading].startswith(f"{np.mean([getattr(row, part).mean_deg for row in rows]):.2f} ±")
    assert len(table.rows[-1]) == len(table.columns)


def test_fingertip_table_agrees_with_the_recorded_curves(trial: Path) -> None:
    lifts = read(trial).lifts
    for lift in lifts:
        assert lift.errors("B", "C").mean() == pytest.approx(lift.re.mean_deg, abs=0.01)
    table = fingertip_table(lifts)
    assert [row[0] for row in table.rows] == ["both, fused", *lifts[0].tips]
    fused = np.mean([lift.re.mean_deg for lift in lifts])
    assert table.rows[0][2].startswith(f"{fused:.2f} ±")
    for serial, row in zip(lifts[0].tips, table.rows[1:], strict=True):
        own = [replace(lift, angles={**lift.angles, FUSED: lift.tips[serial]}) for lift in lifts]
        means = [lift.errors("B").mean() for lift in own]
        assert row[1].startswith(f"{np.mean(means):.2f} ±")


@pytest.mark.heavy
def test_points_of_final_angles_name_their_lifts_with_values(page: Page) -> None:
    plots = re.findall(r'<script type="application/json" class="plot">(.*?)</script>', page.html)
    finals = next(plot for plot in map(json.loads, plots) if plot["x"]["label"].startswith("final marker"))
    assert [anchor for *_, anchor in finals["spots"]] == ["lift-1", "lift-2"]
    x, y, text, _ = finals["spots"][1]
    assert text.replace("\N{MINUS SIGN}", "-") == f"wrench, lift 2: estimate {y:+.1f}°, markers {x:+.1f}°"
    dots = next(shape for shape in finals["shapes"] if shape.get("dot"))
    assert dots["at"] == [[x, y] for x, y, *_ in finals["spots"]]
    assert page.links.count("#lift-2") == 2  # from its row, and from its frames among the worst lifts


@pytest.mark.usefixtures("quick_pages")
def test_a_real_bench_is_named_and_not_called_simulated(drawn_trial: Any, tmp_path: Path) -> None:
    folder = drawn_trial(tmp_path / "s", (12.0,), simulated=False, bench="lab 2")
    found = page_of(folder)
    assert "SIMULATED" not in found.text
    assert "bench 'lab 2'" in found.text
    assert "No calibration of camera and hand-eye is in use" in found.text


@pytest.mark.heavy
@pytest.mark.usefixtures("quick_pages")
def test_a_corrupt_and_a_missing_recording_are_named_and_the_rest_is_shown(
    drawn_trial: Any, tmp_path: Path
) -> None:
    folder = drawn_trial(tmp_path / "s", (12.0, -20.0, 8.0))
    cut = folder / "lifts" / "001.mcap"
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    (folder / "lifts" / "002.mcap").unlink()
    written = write_report([folder])
    found = Page(written.path)
    assert "2 of 3 recordings cannot be read" in written.problems[0]
    assert "001.mcap" in found.text
    assert "002.mcap" in found.text
    assert any("wrench, lift 3" in name for name in found.figures)
    assert not any("wrench, lift 1" in name for name in found.figures)


@pytest.mark.usefixtures("quick_pages")
def test_a_damaged_line_is_named_and_left_out(drawn_trial: Any, tmp_path: Path) -> None:
    folder = drawn_trial(tmp_path / "s")
    lines = (folder / "lifts.jsonl").read_text().splitlines()
    (folder / "lifts.jsonl").write_text(lines[0][:50] + "\n" + lines[1] + "\n" + "null\n")
    found = page_of(folder)
    assert "lifts.jsonl: 2 of 3 lines damaged (line 1: is not valid JSON" in found.text
    assert "line 3: must be a table, found null" in found.text
    assert any("wrench, lift 2" in name for name in found.figures)


@pytest.mark.parametrize(
    ("manifest", "said"),
    [
        ('{"schema_version": 9, "kind": "trial"}', "schema version 9"),
        ('{"schema_version": 1, "kin', "cannot be read"),
        ('{"schema_version": 2, "kind": "dream"}', "'dream' session"),
    ],
)
def test_unreadable_session_gets_a_page_with_the_reason(
    drawn_trial: Any, tmp_path: Path, manifest: str, said: str
) -> None:
    folder = drawn_trial(tmp_path / "s", (12.0,))
    (folder / "session.json").write_text(manifest)
    found = page_of(folder)
    assert said in found.text
    assert "lifts/001.mcap" in found.text


@pytest.mark.heavy
@pytest.mark.usefixtures("quick_pages")
def test_unfinished_session_and_lift_without_angles_are_shown_as_such(
    drawn_trial: Any, tmp_path: Path
) -> None:
    folder = drawn_trial(tmp_path / "unfinished", (12.0,), status="running")
    (folder / "lifts.jsonl").unlink()
    found = page_of(folder)
    assert "Unfinished: 0 of 1 lift accepted" in found.text
    assert "--resume" in found.text
    folder = drawn_trial(tmp_path / "silent")
    nothing = {"re": None, "re_b": None, "re_held": None, "answered": 0.0, "final_estimate_deg": None}
    edited(folder, 1, **nothing, states={"unobservable": 300})
    found = page_of(folder)
    assert "no answer" in found.text
    assert "most often 'unobservable'" in found.text


@pytest.mark.heavy
@pytest.mark.usefixtures("quick_pages")
def test_invalid_report_source_is_rejected(tmp_path: Path, trial: Path) -> None:
    for sources, out, said in (
        ([tmp_path / "nowhere"], None, "there is no such session"),
        ([tmp_path], None, "neither a session nor CSV"),
        ([trial, trial], None, "rig compare compares two"),
        ([trial], tmp_path, "is a folder"),
        ([trial], tmp_path / "a" / "b.html", "no such folder"),
    ):
        with pytest.raises(InputError, match=said):
            write_report(sources, out)


@pytest.mark.heavy
@pytest.mark.usefixtures("quick_pages")
def test_a_recording_shows_its_poses_and_what_its_pose_file_does_not_reach(
    drawn_recording: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = drawn_recording(tmp_path / "s")
    found = page_of(folder)
    for part in (
        "Recording of t1 wrench", "GraspError: the fingers closed on nothing", "T1 was never touched",
        "6 images of T1 and T2, grips of 0 to 5 steps past contact", "--poses 15",
    ):  # fmt: skip
        assert part in found.text
    assert found.images == 2
    assert sum("Positions of the contacts" in name for name in found.figures) == 2
    monkeypatch.setattr("rig.report.recording_page.grasp_poses", lambda _: [None, None])
    found = page_of(folder)
    assert "Nothing stands out." in found.text
    assert "--poses 15" not in found.text
    assert "Not reached by the poses of the object's file: T1 was never touched" in found.text


def test_a_contact_sheet_names_sensor_and_grip_in_the_picture(drawn_recording: Any, tmp_path: Path) -> None:
    folder = drawn_recording(tmp_path / "s")
    manifest = read_manifest_of(folder, RecordManifest, "no recording")
    taken = [image for image in read_recording(folder, manifest).taken if image.row.pose == 1]
    sheet = montage(taken)
    assert sheet.shape[0] == 2 * (LABEL_PX + THUMB_PX[1] + LABEL_PX)
    other = [replace(image, about=replace(image.about, grip_counts=9)) for image in taken]
    renamed = [replace(image, about=replace(image.about, serial=f"A{image.about.serial}")) for image in taken]
    below = slice(LABEL_PX + THUMB_PX[1], 2 * LABEL_PX + THUMB_PX[1])
    assert (montage(other)[below] != sheet[below]).any()
    assert (montage(other)[:LABEL_PX] == sheet[:LABEL_PX]).all()
    assert (montage(renamed)[:LABEL_PX] != sheet[:LABEL_PX]).any()


@pytest.mark.usefixtures("quick_pages")
def test_images_that_cannot_be_read_are_named(drawn_recording: Any, tmp_path: Path) -> None:
    folder = drawn_recording(tmp_path / "s")
    image = next(folder.rglob("p01_01*.png"))
    image.write_bytes(b"no picture")
    (folder / "reference" / "T1.png").unlink()
    found = page_of(folder)
    assert image.name in found.text
    assert "The reference image of T1 cannot be read" in found.text
