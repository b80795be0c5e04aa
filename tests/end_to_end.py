"""The end-to-end tests of a plain run: one for each capability of the product, although each takes seconds.

The other tests of a plain run take less than a second of CPU time (limit: `support.cpu_limit.LIMIT_S`).
"""

import pytest

from support.browser import NEEDS_CHROMIUM

END_TO_END = {
    "tests/cli/test_calibrate.py": (
        "test_bench_is_calibrated_and_its_samples_give_the_same_file_again[camera]",
        "test_bench_is_calibrated_and_its_samples_give_the_same_file_again[hand-eye]",
        "test_bench_is_calibrated_and_its_samples_give_the_same_file_again[markers]",
        "test_gel_is_calibrated_from_presses",
        "test_opening_and_clocks_are_calibrated_from_files",
    ),
    "tests/cli/test_commands.py": (
        "test_trial_prints_one_json_object_and_is_marked_simulated",
        "test_recording_resumes_and_has_the_layout_of_the_data_set",
        "test_doctor_prints_one_json_object_and_saves_frames",
    ),
    "tests/cli/test_estimate.py": (
        "test_the_table_has_a_row_per_frame_with_times_as_given",
        "test_ros_bag_gives_the_estimates_of_the_same_frames_as_files",
    ),
    "tests/cli/test_label_angle.py": ("test_lines_become_labels_that_the_benchmark_reads",),
    "tests/cli/test_live.py": ("test_json_has_an_object_per_frame_and_the_summary_counts_them",),
    "tests/cli/test_objects.py": ("test_trial_lifts_own_object_and_stores_the_grasp_position",),
    "tests/cli/test_report_commands.py": (
        "test_two_estimators_are_compared_on_one_session",
        "test_first_lift_is_played_into_a_default_file",
    ),
    "tests/cli/test_segment.py": ("test_every_mask_has_the_size_of_its_image",),
    "tests/cli/test_show.py": ("test_page_shows_the_clip_until_ctrl_c",),
    "tests/cli/test_stopping.py": ("test_one_signal_ends_safely",),
    "tests/cli/test_teach.py": ("test_taught_position_is_written_and_can_be_lifted",),
    "tests/cli/test_watching.py": ("test_recording_can_be_watched",),
    "tests/scenario/test_export.py": (
        "test_lerobot_data_set_has_its_parts_and_the_stored_images",
        "test_exported_bag_is_read_as_the_frames_of_the_recording",
    ),
    "tests/scenario/test_interrupted.py": (
        "test_resumed_session_repeats_the_lift_and_keeps_the_interrupted_recording",
    ),
    "tests/scenario/test_own_estimator.py": (
        "test_own_estimator_gives_the_rows_of_the_one_it_wraps_in_a_replay_by_two_processes",
    ),
    "tests/scenario/test_reaction.py": ("test_tightening_catches_an_object_that_slips_otherwise",),
    "tests/scenario/test_stored_sessions.py": (
        "test_replay_gives_the_stored_rows",
        "test_stored_sessions_have_reports_and_a_film",
    ),
    "tests/scenario/test_wire.py": ("test_wire_lift_measures_the_slip_and_loses_no_frame",),
    "tests/scenario/ur5e/test_faults.py": ("test_protective_stop_is_released_on_request_only",),
    "tests/scenario/ur5e/test_motions.py": (
        "test_stop_during_the_preparation_prevents_a_motion_and_disconnecting_stops_one",
        "test_motion_out_of_reach_or_joint_limits_is_rejected_and_the_program_continues",
        "test_stop_from_another_thread_ends_the_motion",
    ),
    "tests/scenario/ur5e/test_processes.py": (
        "test_controller_stops_the_arm_if_it_gets_no_commands",
        "test_killed_program_leaves_no_process_and_stops_the_arm",
    ),
    "tests/unit/drivers/robotiq_3f/test_driver.py": (
        "test_gripper_activates_moves_and_stops_over_every_transport",
    ),
    "tests/unit/rig/benchmark/test_clips.py": ("test_command_writes_page_json_and_table_and_exits_with_4",),
    "tests/unit/rig/python/test_sessions.py": (
        "test_estimator_of_a_lift_gives_its_angles_and_needs_the_pixel_aspect",
    ),
}


def is_end_to_end(item: pytest.Item) -> bool:
    """Whether a test is listed in `END_TO_END`, alone or with the name of its parameters."""
    file, _, test = item.nodeid.partition("::")
    name = test.partition("@")[0]
    return not {name, name.partition("[")[0]}.isdisjoint(END_TO_END.get(file, ()))


def is_heavy(item: pytest.Item) -> bool:
    """Whether a test is marked 'heavy' or needs a browser, which alone takes seconds."""
    marks = list(item.iter_markers())
    return NEEDS_CHROMIUM.mark in marks or any(mark.name == "heavy" for mark in marks)
