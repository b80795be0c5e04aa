"""Tables as other programs write them give the same results as plainly written ones."""

from pathlib import Path

import numpy as np
import pytest

from calibration.gripper import Direction
from calibration.hand_eye.solve import Setup
from drivers.errors import InputError
from rig.calibrate.clocks import solve_pair
from rig.calibrate.gripper import GripperOptions, solve_openings
from rig.calibrate.hand_eye import HandEyeOptions, solve_hand_eye
from rig.calibrate.kind import Samples
from rig.calibrate.samples import read_poses, read_stream
from rig.frames.times import times_from_table


def test_stream_with_exponents_keeps_its_times(tmp_path: Path) -> None:
    samples = np.column_stack([np.linspace(0.5, 30.0, 900), np.linspace(-1e-3, 300.0, 900)])
    for name, how in (
        ("savetxt", {"fmt": "%.18e", "comments": ""}), ("comment", {"fmt": "%.18e"}),
        ("matlab", {"fmt": "%.15g"}), ("plain", {"fmt": "%.9f"}),
    ):  # fmt: skip
        np.savetxt(tmp_path / name, samples, delimiter=",", header="t_s,value", **how)
        stream = read_stream(tmp_path / name)
        np.testing.assert_allclose(stream.time_ns, np.round(samples[:, 0] * 1e9), atol=1)
        np.testing.assert_allclose(stream.values, samples[:, 1], rtol=1e-9, atol=1e-9)


def test_times_in_nanoseconds_with_exponents_are_exact(tmp_path: Path) -> None:
    times_ns = 1_763_000_000_000_000_000 + 33_333_333 * np.arange(200)
    np.savetxt(
        tmp_path / "x.csv",
        np.column_stack([times_ns, np.sin(np.arange(200))]),
        delimiter=";",
        header="time_ns;value",
        comments="",
    )
    assert np.array_equal(
        read_stream(tmp_path / "x.csv").time_ns, times_ns.astype(np.float64).astype(np.int64)
    )


def test_poses_of_another_frame_than_the_tool_are_refused_for_hand_eye(tmp_path: Path) -> None:
    table = tmp_path / "poses.csv"
    for frame, said in (("tcp", None), ("flange", r"says 'flange', and base_T_tcp is needed")):
        table.write_text(f"id,x_m,y_m,z_m,qx,qy,qz,qw,child_frame\n1,0,0,0.3,0,0,0,1,{frame}\n")
        (tmp_path / "targets.csv").write_text("id,x_m,y_m,z_m,qx,qy,qz,qw\n1,0,0,0.5,0,0,0,1\n")
        if said is None:
            assert solve_hand_eye(Samples(tmp_path), HandEyeOptions(setup=Setup.EYE_IN_HAND)).used == 0
        else:
            with pytest.raises(InputError, match=said):
                solve_hand_eye(Samples(tmp_path), HandEyeOptions(setup=Setup.EYE_IN_HAND))


def test_frame_numbers_with_exponents_are_the_frames(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "x.csv", [[0, 20.5], [1, 30.25]], delimiter=",", header="frame,t_s", comments="")
    times = times_from_table(tmp_path / "x.csv", ["a.png", "b.png"])
    assert [time.time_ns for time in times] == [20_500_000_000, 30_250_000_000]


@pytest.mark.heavy
@pytest.mark.parametrize("case", ["savetxt", "savetxt_0to30"])
def test_sync_of_streams_written_by_numpy(real_data: Path, case: str) -> None:
    plain, other = (
        solve_pair(real_data / "field_cases" / "sync" / name, "robot", "camera") for name in ("plain", case)
    )
    assert plain.value["add_to_stream_s"] == pytest.approx(0.037, abs=1e-4)
    assert other.value["add_to_stream_s"] == pytest.approx(
        plain.value["add_to_stream_s"], abs=1e-4
    )  # plain has rounded times


def test_blanks_after_commas_change_nothing(real_data: Path) -> None:
    cases = real_data / "field_cases"
    for file in ("poses.csv", "targets.csv"):
        assert read_poses(cases / "hand_eye/spaces" / file) == read_poses(cases / "hand_eye/good" / file)
    plain, blank = (
        solve_openings(Samples(cases / "gripper" / name), GripperOptions()) for name in ("mm", "space")
    )
    closing, plain_closing = blank.value[Direction.CLOSING], plain.value[Direction.CLOSING]
    assert closing["opening_m"].tolist() == plain_closing["opening_m"].tolist()
    assert len(closing["counts"]) > 2
