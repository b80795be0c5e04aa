"""`rig sessions`: search by tag and object, sorting, checks, listing in several processes, contact areas."""

import json
import shutil
import subprocess
import sys
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from support.command_line import answer, rig, succeed

STORED = Path(__file__).parents[1] / "data"


def listed(folder: Path, *options: object) -> list[dict[str, Any]]:
    done = succeed("sessions", folder, "--json", *options)
    return json.loads(done.stdout)["sessions"]


@pytest.fixture(scope="module")
def named(tmp_path_factory: pytest.TempPathFactory, one_lift: Path) -> Path:
    """Return three copies of a trial with different dates, remarks and errors."""
    folder = tmp_path_factory.mktemp("named")
    words = ({"name": "Beta", "tags": ["gel-1", "x"]}, {"tags": ["gel-1"], "operator": "Ada"}, {})
    for number, said in enumerate(words):
        place = folder / f"s{number}"
        shutil.copytree(one_lift, place)
        manifest = json.loads((place / "session.json").read_text())
        manifest |= {"started": f"2026-03-{20 - number:02d}T08:00:00+00:00"}
        if said:
            manifest["remarks"] = {"name": "", "note": "", "tags": [], "operator": "", **said}
        (place / "session.json").write_text(json.dumps(manifest))
    return folder


def names(folder: Path, *options: object) -> list[str]:
    return [Path(entry["session"]).name for entry in listed(folder, *options)]


def test_sessions_are_found_by_tags_and_objects_and_sorted(named: Path) -> None:
    assert names(named, "--tag", "gel-1") == ["s0", "s1"]
    assert names(named, "--tag", "gel-1", "--tag", "x") == ["s0"]
    assert names(named, "--tag", "unused") == []
    assert len(names(named, "--object", "T2")) == len(names(named, "--object", "toothbrush")) == 3
    assert names(named, "--object", "wrench") == []
    assert names(named, "--sort", "date") == ["s2", "s1", "s0"]
    assert names(named, "--sort", "date", "--reverse") == ["s0", "s1", "s2"]
    by_name = names(named, "--sort", "name", "--reverse")
    assert by_name == ["s0", "s1", "s2"], "sessions without a name are last"
    assert names(named) == ["s0", "s1", "s2"]


def test_table_has_remark_columns_only_with_remarks(named: Path, one_lift: Path) -> None:
    table = rig("sessions", named).stdout
    assert all(word in table for word in ("Beta", "gel-1, x", "Ada", "operator"))
    assert "operator" not in rig("sessions", one_lift).stdout


def test_damaged_bytes_are_detected_except_with_quick(
    tmp_path: Path, one_lift: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.cli.sessions.MOST_CHECKED", 2)
    folder = tmp_path / "s"
    shutil.copytree(one_lift, folder)
    recording = next((folder / "lifts").iterdir())
    data = bytearray(recording.read_bytes())
    data[len(data) // 2] ^= 1
    recording.write_bytes(data)
    assert listed(folder, "--quick")[0]["state"] == "complete"
    (entry,) = listed(folder)
    assert entry["state"] == "broken"
    assert recording.name in entry["problem"]
    for number in range(2):
        shutil.copytree(folder, tmp_path / f"{number}")
    many = rig("sessions", tmp_path, "--json")
    assert {entry["state"] for entry in json.loads(many.stdout)["sessions"]} == {"complete"}
    assert "note: the checksums of 3 sessions are not compared" in many.stderr
    checked = rig("sessions", tmp_path, "--check", "--json")
    assert {entry["state"] for entry in json.loads(checked.stdout)["sessions"]} == {"broken"}
    recording.unlink()
    assert "recording is missing" in listed(folder, "--quick")[0]["problem"]


def test_check_ends_with_exit_code_2_if_a_session_is_broken(tmp_path: Path, one_lift: Path) -> None:
    for name in ("whole", "broken"):
        shutil.copytree(one_lift, tmp_path / name)
    assert rig("sessions", tmp_path, "--check").returncode == 0
    next((tmp_path / "broken" / "lifts").iterdir()).unlink()
    for options in (("--check",), ("--check", "--json")):
        done = rig("sessions", tmp_path, *options)
        assert done.returncode == 2
        assert done.stderr.splitlines()[-1].endswith("1 of 2 sessions broken; see the messages above")
        assert "recording is missing" in done.stdout
    assert rig("sessions", tmp_path / "whole", "--check").returncode == 0
    assert rig("sessions", tmp_path).returncode == 0


def test_session_without_its_recordings_keeps_its_results(named: Path, tmp_path: Path) -> None:
    shutil.copytree(named, tmp_path / "all")
    shutil.rmtree(tmp_path / "all" / "s1" / "lifts")
    done = succeed("sessions", tmp_path / "all", "--json", "--check")
    states = [(entry["state"], entry["mare_deg"]) for entry in json.loads(done.stdout)["sessions"]]
    assert [state for state, _ in states] == ["complete", "without recordings", "complete"]
    assert len({mare for _, mare in states}) == 1
    size_mb = sum(file.stat().st_size for file in tmp_path.rglob("*") if file.is_file()) / 1e6
    assert f"3 sessions, {size_mb:,.0f} MB" in done.stderr


@pytest.mark.heavy
def test_parallel_listing_of_many_sessions_gives_the_same_result(tmp_path: Path) -> None:
    for number in range(8):
        shutil.copytree(STORED / "stored_trial", tmp_path / f"{number:02d}")
    code = "import rig.cli.sessions as s; s.SIDE_BY_SIDE = 2; from rig.cli.main import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "sessions", str(tmp_path), "--json"],
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout == rig("sessions", tmp_path, "--json").stdout
    assert "Process" not in done.stderr, "workers are ended without a word"
    assert len(json.loads(done.stdout)["sessions"]) == 8


def test_page_of_sessions_links_to_reports_and_escapes_names(named: Path, tmp_path: Path) -> None:
    both = tmp_path / "both # 2"
    shutil.copytree(named, both)
    (both / "s0").rename(both / "<i>")
    (both / "s1" / "report.html").write_text("a report")
    done = answer("sessions", both / ".", "--page", tmp_path / "all.html")
    assert done["page"] == str(tmp_path / "all.html")
    text = (tmp_path / "all.html").read_text()
    assert '<a href="both%20%23%202/s1/report.html">' in text
    assert f'<span data-session="{both}/s1">s1</span></a>' in text
    assert "&lt;i&gt;</span></td>" in text
    assert text.index("</table>") < text.index("<h3>Error on SIMULATED benches</h3>"), "the list comes first"
    assert f"<h1>Sessions in {both}</h1>" in text
    assert 'data-filter="choose"' in text


def test_estimator_refused_lifts_and_limits_are_listed(named: Path, tmp_path: Path) -> None:
    shutil.copytree(named, tmp_path / "all")
    for name, figure, upper in (
        ("s0", "mare_deg", 0.0), ("s1", "mare_deg", 90.0), ("s2", "re_max_deg", 0.0),
    ):  # fmt: skip
        file = tmp_path / "all" / name / "session.json"
        manifest = json.loads(file.read_text())
        manifest["config"]["limits"] = [{"figure": figure, "upper": upper}]
        file.write_text(json.dumps(manifest))
    (tmp_path / "all/s2/lifts.jsonl").write_text("")  # its first lift is not finished
    done = rig("sessions", tmp_path / "all", "--json")
    found = json.loads(done.stdout)["sessions"]
    assert [entry["limits_missed"] for entry in found] == [1, 0, None]
    assert [(entry["estimator"], entry["window"]) for entry in found] == [("slip", 1)] * 3
    table = " ".join(done.stderr.split())
    assert "1 missed" in table
    assert "kept" in table


def test_contact_area_of_each_fingertip_is_listed(tmp_path: Path) -> None:
    found = {Path(each["session"]).name: each["contact_area_px"] for each in listed(STORED)}
    assert found["stored_record"] == {"SIM-D0001": 812.0, "SIM-D0002": 1613.0}
    assert found["stored_trial"] == pytest.approx({"SIM-D0001": 1144.33, "SIM-D0002": 1129.33}, abs=0.01)
    page = tmp_path / "page.html"
    done = succeed("sessions", STORED, "--page", page)
    assert "812, 1613" in " ".join(done.stdout.split())
    assert "812, 1613" in page.read_text()


@pytest.mark.heavy
def test_sessions_with_a_reaction_are_listed_and_drawn_separately(one_lift: Path, tmp_path: Path) -> None:
    for name, react in (("plain", "none"), ("caught", "tighten")):
        folder = tmp_path / "sessions" / name
        shutil.copytree(one_lift, folder)
        manifest = json.loads((folder / "session.json").read_text())
        (folder / "session.json").write_text(json.dumps({**manifest, "react": react}))
    page = tmp_path / "page.html"
    done = answer("sessions", tmp_path / "sessions", "--page", page)
    assert [each["react"] for each in done["sessions"]] == ["tighten", None]
    text = unescape(page.read_text())
    assert "Error on SIMULATED benches</" in text
    assert "Error on SIMULATED benches, reaction to slip 'tighten'</" in text
    began_s, ended_s = json.loads(text.split('class="plot">')[1].split("</script>")[0])["x"]["limits"]
    assert ended_s - began_s == pytest.approx(600.0), "5 minutes around a single session"
    assert "┃ reaction ┃" in rig("sessions", tmp_path / "sessions").stdout
    shutil.rmtree(tmp_path / "sessions" / "caught")
    assert "┃ reaction ┃" not in rig("sessions", tmp_path / "sessions").stdout
