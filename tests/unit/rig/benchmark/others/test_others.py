"""`rig benchmark others`: what is not here is skipped and says how to get it; what is here is judged."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.errors import InputError
from rig.benchmark.others.benchmark import Sources, as_json, others_section, others_table, run_others
from rig.benchmark.others.pose_sets import _coverage, _figures, _table
from rig.benchmark.others.real_sets import run_streams
from rig.benchmark.others.recordings import CSV_PLACE, RECORDED, run_recordings
from rig.benchmark.others.robot_world import FOLDER, REPOSITORY, run_robot_world
from rig.benchmark.others.rows import Row, commit_of, skipped

NOTHING = Sources(None, None, Path("nowhere"))


def test_what_is_not_here_is_skipped_and_says_how_to_get_it() -> None:
    rows = run_others(["boards", "streams", "files"], NOTHING, lambda text: None)
    assert [row.met for row in rows] == [None] * 4
    assert "git clone https://github.com/eirikwha/hand_eye_calibration" in rows[0].result
    assert "git clone https://github.com/ethz-asl/hand_eye_calibration" in rows[2].result
    assert "--session" in rows[3].result


def test_clients_that_are_not_installed_are_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.benchmark.others.clients.installed", lambda package: None)
    rows = run_others(["clients"], NOTHING, lambda text: None)
    assert len(rows) == 12
    assert all(row.result.startswith("skipped: ") for row in rows)
    assert {"skipped: pip install urx", "skipped: pip install ur-rtde"} <= {row.result for row in rows}


def test_a_part_that_is_none_is_refused() -> None:
    with pytest.raises(
        InputError, match=r"part 'clints' \(did you mean 'clients'\?\): choose one of clients, kinhec"
    ):
        run_others(["clints"], NOTHING, lambda text: None)


def test_the_table_says_what_did_not_come_out() -> None:
    rows = [Row("a", "b | c", "1", "x", "1 mm", "2 mm", False), skipped("a", "d", "pip install d")]
    table = others_table(rows)
    assert [row[-1] for row in table.rows] == ["NO", ""]
    assert "| a | b / c | 1 | x | 1 mm | 2 mm | NO |" in others_section(rows)
    assert as_json(rows)["rows"][0]["met"] is False


def test_ours_is_held_to_every_solver_and_a_missing_answer_is_the_worst() -> None:
    ours = [(0.1, 1.0)] * 20
    better, gave_up = [(0.09, 1.0)] * 20, [(0.1, 1.0)] * 18 + [(np.inf, np.inf)] * 2
    rows = {row.what: row for row in _table({"ours": ours, "better": better, "gave up": gave_up}, "1")}
    assert rows["hand-eye, 20 sequences: better"].met is False
    assert rows["hand-eye, 20 sequences: gave up"].met is True
    assert _figures(gave_up)[2] == np.inf


@pytest.mark.parametrize(("held", "met"), [(34, True), (30, False), (37, False)])
def test_coverage_is_asked_from_both_sides(held: int, met: bool) -> None:
    rows = _coverage([True] * held + [False] * (37 - held), [], [], "1")
    assert rows[0].met is met
    assert _coverage([True], [], ["noise-1"], "1")[1].met is False


def test_a_clones_commit_is_read_without_git(tmp_path: Path) -> None:
    assert commit_of(tmp_path) == "unknown"
    (tmp_path / ".git").mkdir()
    (tmp_path / ".git" / "HEAD").write_text("ref: refs/heads/main\n")
    (tmp_path / ".git" / "packed-refs").write_text("# pack-refs\n0123456789abcdef refs/heads/main\n")
    assert commit_of(tmp_path) == "0123456"
    (tmp_path / ".git" / "HEAD").write_text("fedcba9876543210\n")
    assert commit_of(tmp_path) == "fedcba9"


def test_offsets_of_real_streams_are_those_of_the_best_correlation() -> None:
    clones = os.environ.get("RIG_CLONES")
    if clones is None or not (Path(clones) / "ethz-asl" / "hand_eye_calibration").is_dir():
        pytest.skip("RIG_CLONES names no folder with a clone ethz-asl/hand_eye_calibration (docs/others.md)")
    rows = run_streams(Path(clones), lambda text: None)
    assert [row.met for row in rows].count(True) >= 6
    assert not [row for row in rows if row.met is False]


def test_protective_stops_are_found_where_a_recording_has_them(tmp_path: Path) -> None:
    place = tmp_path / RECORDED[0] / CSV_PLACE
    place.parent.mkdir(parents=True)
    status = [1, 1, 3, 3, 1, 7, 9]
    lines = [f"{0.008 * n:.3f} 7 2 {code}" for n, code in enumerate(status)]
    place.write_text("\n".join(["timestamp robot_mode runtime_state safety_status", *lines]))
    row, *others = run_recordings(tmp_path, lambda text: None)
    assert (row.ours, row.theirs, row.met) == ("2", "2", True)
    assert row.result.startswith("7 states, 125 Hz: 3 running, 0 without a program")
    assert all(other.result.startswith("skipped: ") for other in others)


def test_a_robot_world_set_is_solved_as_its_published_answer_says(tmp_path: Path) -> None:
    """A made set of the same layout: exact poses, so that every method finds the answer that made them."""
    rng = np.random.default_rng(3)
    place = tmp_path / REPOSITORY / FOLDER
    (place / "rwhe_AA_RPI").mkdir(parents=True)

    def pose(turn: float, move: float) -> np.ndarray:
        made = np.eye(4)
        made[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, turn, 3)).as_matrix()
        made[:3, 3] = rng.normal(0.0, move, 3)
        return made

    x, z = pose(1.0, 400.0), pose(0.3, 30.0)
    robots = [pose(0.5, 300.0) for _ in range(40)]
    noise = [pose(0.002, 0.5) for _ in robots]
    seen = [n @ z @ b @ np.linalg.inv(x) for n, b in zip(noise, robots, strict=True)]

    def lines(matrix: np.ndarray) -> str:
        return "\n".join(" ".join(f"{value:.6f}" for value in row) for row in matrix)

    (place / "robot_cali.txt").write_text("\n".join(["40", *(lines(b) + "\n" for b in robots)]))
    views = [" ".join(f"{v:.6f}" for v in (*a[:3, :3].reshape(-1), *a[:3, 3])) for a in seen]
    (place / "cali.txt").write_text(
        "\n".join(["40", *(f"image.png  1 0 0 0 1 0 0 0 1 {v} 0 0" for v in views)])
    )
    (place / "rwhe_AA_RPI/transformations.txt").write_text(f"X\n{lines(x)}\nZ 0\n{lines(z)}\n")
    rows = run_robot_world(tmp_path, lambda text: None)
    assert len(rows) == 3
    for row in rows:
        ours, theirs = (float(said.split(",")[0]) for said in (row.ours, row.theirs))
        assert ours < 3.0
        assert ours < 1.3 * theirs
