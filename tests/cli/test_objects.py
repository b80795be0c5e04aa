"""A lab's own objects from the command line: listed, created, lifted, recorded, and stored in the session."""

import json
import shutil
from pathlib import Path

import pytest

from support.benches import short_phases
from support.command_line import answer, refusal, rig, succeed

pytestmark = pytest.mark.usefixtures("quick_pages")
LEVER = """id = "lever"
name = "my lever"
orientations_deg = [0.0, 20.0]
grip_mm = [1.87, 3.11]

[[position]]
name = "end"
offset_m = -0.05
width_m = 0.02
lift_height_m = 0.06
surface = "edge"
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory, light_bench_file: Path) -> Path:
    """A lab's folder: a bench file, and an object beside it."""
    folder = tmp_path_factory.mktemp("lab")
    shutil.copy(light_bench_file, folder / "bench.toml")
    (folder / "objects").mkdir()
    (folder / "objects" / "lever.toml").write_text(LEVER)
    return folder


@pytest.fixture(scope="module")
def session(lab: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A trial of one lift of it, in a place where its file is not."""
    folder = tmp_path_factory.mktemp("elsewhere") / "session"
    what = ("--object", "my lever", "--lifts", 1, "--bench", lab / "bench.toml", "--estimator", "pca")
    with short_phases():
        done = rig("trial", *what, "--jobs", 1, "--no-report", "--out", folder, "--json")
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.heavy
def test_new_object_slips_with_its_values_and_holds_with_the_offset_that_its_comment_names(
    tmp_path: Path, light_bench_file: Path
) -> None:
    folder = tmp_path / "objects"
    assert rig("objects", "new", folder / "slipping.toml").returncode == 0
    text = (folder / "slipping.toml").read_text()
    assert "slips with 0.03, because its weight turns it, and holds with 0.0." in text
    held = text.replace("slipping", "holding").replace("offset_m = 0.030", "offset_m = 0.0")
    (folder / "holding.toml").write_text(held)
    what = ("--object", "slipping", "--object", "holding", "--lifts", 1, "--bench", light_bench_file)
    with short_phases():
        done = rig("trial", *what, "--objects", folder, "--estimator", "pca", "--jobs", 1, "--no-report",
                   "--out", tmp_path / "session")  # fmt: skip
    assert done.returncode == 0, done.stderr
    outcomes = {row.split()[2]: row for row in done.stderr.splitlines() if row.startswith(("1/2", "2/2"))}
    assert ": slipped, " in outcomes["slipping"]
    assert ": held, " in outcomes["holding"]


def test_objects_are_listed_with_their_source_also_new_ones(lab: Path, tmp_path: Path) -> None:
    new = rig("objects", "new", tmp_path / "cup.toml")
    assert (new.returncode, new.stdout.strip()) == (0, str(tmp_path / "cup.toml")), new.stderr
    assert "cup" in rig("objects", "--objects", tmp_path, "--json").stdout
    assert rig("objects", "new", tmp_path / "cup.toml").returncode == 2
    done = rig("objects", "--bench", lab / "bench.toml", "--json")
    listed = {each["id"]: each for each in json.loads(done.stdout)["objects"]}
    assert listed["lever"]["from"] == str(lab / "objects" / "lever.toml")
    assert listed["t1"]["from"] == "the package"
    assert "my lever" not in rig("objects", "--bench", "fake").stdout
    assert "lever.toml" in rig("objects", "--objects", lab / "objects").stdout.replace("\n", "")


def test_dry_run_shows_own_object_and_its_assumptions(lab: Path) -> None:
    done = rig(
        "trial", "--object", "lever", "--lifts", 1, "--bench", lab / "bench.toml", "--dry-run", "--json"
    )
    plan = json.loads(done.stdout)
    assert done.returncode == 0
    assert any(line.startswith("SIMULATED: object lever has no simulated twin") for line in plan["plan"])
    assert any("lever/1 my lever" in line for line in plan["plan"])


@pytest.mark.heavy
def test_trial_lifts_own_object_and_stores_the_grasp_position(session: Path) -> None:
    row = json.loads((session / "lifts.jsonl").read_text())
    assert (row["object"], row["name"], row["position"]) == ("lever", "my lever", "end")
    assert row["answered"] > 0.5
    assert abs(row["final_truth_deg"]) > 1.0, "an edge held far from its middle turns"
    kept = json.loads((session / "session.json").read_text())["config"]["objects"]
    assert [each["id"] for each in kept] == ["lever"]


@pytest.mark.heavy
def test_session_is_replayed_and_reported_without_the_object_folder(session: Path) -> None:
    replayed = answer("replay", session, "--jobs", 1)
    assert replayed["identical"] == 1
    succeed("report", session, "--json")
    assert "my lever" in (session / "report.html").read_text()


def test_session_resumes_without_the_object_folder_but_not_with_a_changed_object(
    session: Path, lab: Path, tmp_path: Path, light_bench_file: Path
) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(session, folder)
    again = ("trial", "--resume", "--out", folder, "--no-report", "--json", "--bench")
    done = succeed(*again, light_bench_file)
    assert json.loads(done.stdout)["lifts_accepted"] == 1
    shutil.copytree(lab, tmp_path / "lab")
    changed = tmp_path / "lab" / "objects" / "lever.toml"
    changed.write_text(LEVER.replace("width_m = 0.02", "width_m = 0.025"))
    other = refusal(*again, tmp_path / "lab" / "bench.toml")
    assert "config.objects[0].position[0].width_m 0.02, not 0.025" in other


@pytest.mark.heavy
def test_recording_takes_every_pose_of_the_object_file(lab: Path, tmp_path: Path) -> None:
    folder = tmp_path / "recording"
    what = ("record", "--object", "lever", "--images", 4, "--bench", lab / "bench.toml", "--out", folder)
    done = answer(*what)
    assert done["poses_accepted"] == 2
    assert (folder / "lever_my_lever" / "image_label").is_dir()
    assert "Recording of lever my lever" in (folder / "report.html").read_text()
    assert "has 2 poses in its file, not 3" in refusal(*what[:-1], tmp_path / "more", "--poses", 3)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('surface = "edge"\n', "", "no simulated twin"),
        ("lift_height_m = 0.06\n", "", "no position with a lift_height_m above 0"),
        ("width_m = 0.02", "width_m = 0.13", "fingers"),
        ("width_m", "with_m", "lever.toml:9: position.0.with_m: unknown key (did you mean 'width_m'?)"),
    ],
)
def test_object_that_cannot_be_lifted_is_rejected_before_the_session(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    assert old in LEVER
    (tmp_path / "lever.toml").write_text(LEVER.replace(old, new))
    folder = tmp_path / "session"
    assert said in refusal("trial", "--object", "lever", "--lifts", 1, "--objects", tmp_path, "--out", folder)
    assert not folder.exists()


@pytest.mark.heavy
def test_marker_calibration_accepts_own_object(lab: Path, tmp_path: Path) -> None:
    what = ("calibrate", "markers", "--object", "my lever", "--objects", lab / "objects", "--bench", "fake")
    succeed(*what, "--out", tmp_path, "--json")
    assert rig(*what[:4], "--bench", "fake").returncode == 2, "the object is unknown without its folder"
