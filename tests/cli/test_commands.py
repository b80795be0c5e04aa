"""Commands as a user types them: help, exit codes, one-line errors, one JSON object."""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from drivers.errors import EstimatorError
from rig.tactile.estimators import EstimatorChoice
from support.benches import real_bench_file
from support.command_line import answer, refusal_line, rig, succeed

pytestmark = pytest.mark.usefixtures("quick_pages")
ROOT = Path(__file__).resolve().parents[2]
HEAVY = {
    "cv2", "numpy", "scipy", "onnxruntime", "skimage", "rtde_control", "pymodbus", "mcap", "pyarrow",
    "distributed",
}  # fmt: skip


@pytest.fixture(scope="module")
def session(one_lift: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A trial of one lift, to be resumed and reported."""
    return Path(shutil.copytree(one_lift, tmp_path_factory.mktemp("cli") / "session"))


@pytest.fixture(scope="module")
def same_trial(session: Path, light_bench_file: Path) -> tuple[object, ...]:
    """Return the command that created this session and continues it."""
    what = ("--lifts", 1, "--object", "t2", "--bench", light_bench_file)
    return ("trial", *what, "--out", session, "--resume")


def test_help_imports_no_heavy_library() -> None:
    code = "import sys, rig.cli.main; print(' '.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not HEAVY & set(done.stdout.split())


@pytest.mark.heavy
def test_trial_prints_one_json_object_and_is_marked_simulated(
    session: Path, same_trial: tuple[object, ...]
) -> None:
    done = rig(*same_trial, "--json")
    figures = json.loads(done.stdout)
    assert set(figures) == {
        "session", "lifts_accepted", "lifts_refused", "mare_deg", "mare_std_deg", "mare_interval_deg",
        "mare_b_deg", "mare_held_deg",
        "answered", "wall_s", "bench_s", "report",
    }  # fmt: skip
    assert figures["lifts_accepted"] == 1
    assert done.stderr.startswith("SIMULATED")
    assert "SIMULATED" in done.stderr.splitlines()[-4]
    assert figures["report"] == str(session / "report.html")
    assert "SIMULATED" in (session / "report.html").read_text()
    assert json.loads((session / "session.json").read_text())["simulated"] is True


def test_trial_prints_its_extent_before_it_prepares_the_estimator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: EstimatorChoice) -> None:
        raise EstimatorError("not prepared")

    monkeypatch.setattr(EstimatorChoice, "try_making", fail)
    done = rig("trial", "--lifts", "5", "--jobs", "2", "--estimator", "pca", "--out", tmp_path / "trial")
    said = [line for line in done.stderr.splitlines() if not line.startswith(("loading", "SIMULATED"))]
    assert said[0].startswith("45 lifts of 9 objects, 2 at a time; the remaining time is shown from")
    assert said[-1] == "rig: not prepared"
    assert not (tmp_path / "trial").exists()


def test_missed_limit_exits_with_4_and_keeps_the_session(same_trial: tuple[object, ...]) -> None:
    assert rig(*same_trial, "--no-report", "--max-mare", "0.0001").returncode == 4
    assert rig(*same_trial, "--no-report", "--max-mare", "60").returncode == 0


def test_version_help_and_completion_options_work() -> None:
    result = succeed("--version")
    assert result.stdout.split()[0] == "rig"
    assert result.stdout.split()[1][0].isdigit()
    assert ("(commit " in result.stdout) == (ROOT / ".git").exists()
    assert rig("trial", "-h").stdout == rig("trial", "--help").stdout
    assert "--install-completion" in rig("-h").stdout
    assert "[fakes]" in " ".join(rig("fakes", "serve", "-h").stdout.split())


def test_fakes_status_describes_the_simulated_world(monkeypatch: pytest.MonkeyPatch) -> None:
    state = {
        "start_ns": 5, "now_ns": 7, "tool_m": [0.45, 3.8e-16, 0.3], "tool_moving": False,
        "finger_counts": 6.0, "object": "t1", "held": True, "force_n": 1.234, "turn_deg": -3.14159,
        "devices": {
            "arm": {"host": "127.0.0.1", "robot_mode": "RUNNING", "program_running": True, "tcp_m": [0.45]},
            "gripper": {"requests": 3, "replies": 3, "written": "00ff", "faults": []},
        },
    }  # fmt: skip
    monkeypatch.setattr(
        "rig.bench.fakes_process.fakes_control", lambda config: SimpleNamespace(call=lambda _: state)
    )
    assert rig("fakes", "status", "--bench", "wire").stdout.splitlines() == [
        "tool at (0.450, 0.000, 0.300) m, at rest",
        "fingers at 6 counts",
        "object t1, held with 1.23 N, turned -3.1 deg",
        "arm: robot mode RUNNING, program running yes",
        "gripper: requests 3, replies 3, faults none",
    ]
    assert answer("fakes", "status", "--bench", "wire") == state


@pytest.mark.parametrize(
    ("arguments", "kind", "said"),
    [
        (("trial", "--max-mare", "-1"), "UsageError", "--max-mare"),
        (("trial", "--object", "wrnch"), "InputError", "wrench"),
        (("trial", "--object", "t1", "--object", "wrench"), "InputError", "twice"),
        (("replay", "nowhere"), "SessionError", "there is no such session"),
        (("sessions", "nowhere"), "InputError", "nowhere"),
        (("nothing",), "UsageError", "No such command"),
    ],
)
def test_json_option_prints_an_error_as_one_object(arguments: tuple[str, ...], kind: str, said: str) -> None:
    done = rig(*arguments, "--json")
    error = json.loads(done.stdout)["error"]
    assert (error["kind"], error["exit_code"], done.returncode) == (kind, 2, 2)
    assert said in error["message"]
    assert done.stderr  # for people, as without


@pytest.mark.parametrize("command", [("trial", "--lifts", "1"), ("record", "--object", "7")])
def test_unwritable_session_folder_is_rejected(command: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for out in ("/proc/session", tmp_path / "file", tmp_path / "file" / "s"):
        assert "--out" in refusal_line(*command, "--out", out)


@pytest.mark.heavy
def test_doctor_prints_one_json_object_and_saves_frames(tmp_path: Path) -> None:
    done = succeed("doctor", "--seconds", "0.5", "--json", "--snapshot", str(tmp_path / "today"))
    report = json.loads(done.stdout)
    assert report["simulated"] is True
    assert {finding["device"] for finding in report["findings"]} >= {"arm", "gripper", "SIM-D0001", "disk"}
    assert len(list((tmp_path / "today").iterdir())) == 3


def test_unreachable_bench_is_a_one_line_error(tmp_path: Path) -> None:
    bench = tmp_path / "bench.toml"
    assert rig("bench", "new", str(bench)).returncode == 0
    assert "exists already" in refusal_line("bench", "new", str(bench))
    bench = real_bench_file(tmp_path)
    assert "--jobs" in refusal_line("trial", "--bench", str(bench), "--jobs", "2")
    done = rig("trial", "--bench", str(bench), "--lifts", "1", "--object", "t1", "--out", str(tmp_path / "s"))
    assert done.returncode == 1
    assert "5 of 5 devices cannot be used, nothing was started" in done.stderr.splitlines()[-1]
    assert done.stderr.count("192.0.2.1") == 2  # arm and gripper, each once
    assert not (tmp_path / "s").exists()


@pytest.mark.heavy
def test_recording_resumes_and_has_the_layout_of_the_data_set(tmp_path: Path, light_bench_file: Path) -> None:
    out = tmp_path / "s"
    command = ["record", "--object", "7", "--poses", "2", "--images", "4", "--bench", light_bench_file]
    command += ["--out", out]
    figures = answer(*command)
    assert (figures["poses_accepted"], figures["images_accepted"]) == (2, 4)
    images = sorted((out / "07_spam" / "image_label").glob("*.png"))
    assert len(images) == 4
    rows = (out / "images.csv").read_text().splitlines()
    assert rows[0].split(",")[:4] == ["file", "pose", "position", "orientation_deg"]
    assert len(rows) == 5
    assert len(list((out / "reference").glob("*.png"))) == 2
    written = [(out / "images.csv").read_text(), (out / "poses.jsonl").read_text()]
    written += [image.read_bytes() for image in images]
    assert answer(*command, "--resume")["images_accepted"] == 4
    manifest = json.loads((out / "session.json").read_text())
    (out / "session.json").write_text(json.dumps({**manifest, "status": "running"}))
    first, _ = (out / "poses.jsonl").read_text().splitlines(keepends=True)
    (out / "poses.jsonl").write_text(first)
    for image in images[2:]:
        image.unlink()
    resumed = answer("record", "--resume", "--out", out, "--no-report")
    assert resumed["images_accepted"] == 4, "with the stored bench"
    again = [(out / "images.csv").read_text(), (out / "poses.jsonl").read_text()]
    assert again + [image.read_bytes() for image in images] == written
    assert "--images" in refusal_line(
        "record", "--object", "7", "--images", "10", "--out", str(tmp_path / "t")
    )
