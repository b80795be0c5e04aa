"""`rig estimate`, `rig explain`: estimate the rotation of the contact in your own frames; draw its stages."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

from drivers.errors import InputError, plural
from rig.cli.common import emit_json, mark, print_result, report_broken, report_faults, say
from rig.cli.options import JsonOption, TopicOption
from rig.declared import argument, file_place, folder_place, option
from rig.terminal.screen import begin_phase, end_phase

if TYPE_CHECKING:
    from rig.frames.estimates import EstimatedSeries, Estimation
    from rig.frames.of_session import SessionSeries

_LINE_WIDTH = 97
"""Most characters of a line below the name of the frames, without its indentation."""


@dataclass(frozen=True, slots=True)
class EstimateOptions:
    frames: Path = argument(
        ...,
        "Folder of images (sorted by name), image, video (.avi, .mp4, .mkv, .webm ...), array "
        "(.npy or .npz: T, H, W, 3, uint8, RGB), ROS bag, recording of a lift (.mcap) or session folder, "
        "or a trial of TactileTracking.",
    )
    sensor: str | None = option(
        None, "Serial of one fingertip of a recording or session. Default: all fingertips."
    )
    timestamps: Path | None = option(
        None, "CSV file with columns frame,t_s (frame: file name, stem, or number counted from 0)."
    )
    fps: float | None = option(None, "Frame rate in Hz. Default: that of a video; 60 for images.")
    topic: TopicOption = None
    background: str | None = option(
        None,
        "Frame without contact: an IMAGE, first:N (mean of the first N frames) or auto (computed from "
        "all frames, for contacts that change place). Default: that of the session; else the first frames if "
        "they are alike and later ones differ, or the most frequent image. It is an error if neither "
        "shows the gel without contact.",
    )
    reference_time: str | None = option(
        None,
        "Time in s at which the angle is zero; if that frame has no angle, the next frame with one. "
        "Default: the first frame at which the estimator reports that the contact has settled.",
    )
    lift_from: str | None = option(
        None,
        "Time in s at which the lift begins; the slip alarm is enabled from then on. Default: that of the "
        "session; else when the contact has settled.",
    )
    estimator: str | None = option(
        None,
        "slip, skeleton, ellipse, pca; the last three also with -published; ecc; "
        "kolamuri (for a gel with printed markers), anglenet (a network trained on simulated lifts); "
        "or your own, as package.module:Class (rig estimators). Default: slip.",
    )
    window: int | None = option(
        None, "Report the mean of the last n angles. Default: 2 for the paper's methods, 1 for others.",
        min=1, max=100,
    )  # fmt: skip
    pixel_aspect: float | None = option(
        None,
        "Width of a pixel on the gel divided by its height, as measured by `rig calibrate tactile`. "
        "Default: that of the session; else 1 is assumed, with a larger sigma.",
        min=0.5,
        max=2.0,
    )
    gel: Path | None = option(
        None,
        "YAML file of rig calibrate tactile, for frames of one sensor: slip computes slopes from its look, "
        "not from a map learnt from the contact; and the shift is also in mm.",
    )
    out: Path | None = option(
        None, "CSV file to write; for a session, a folder. Default: print the table on stdout."
    )
    page: Path | None = option(
        None,
        "Also write an HTML page: the angle over time with its sigma band and states, and frames with the "
        "contact.",
        callback=file_place,
    )
    json: JsonOption = False


def estimate(options: EstimateOptions) -> None:
    """Estimate the rotation of the contact in tactile images, in a table with a row per frame.

    The columns are t_s; angle_deg and sigma_deg (standard deviation), relative to the zero frame; state;
    rate_deg_s; shift_x_px and shift_y_px (motion of the contact since the zero frame, to the right and down);
    slip (1 during a slip alarm); only for a recording, sensor; with --gel, shift_x_mm and shift_y_mm. For
    images, the angle is counter-clockwise positive in the image. For a recording or session it is the angle
    of the object. A field is empty if the estimator refuses the frame or does not report the value. With
    --json and without --out the rows are in the JSON object.

    The slip alarm is enabled when the lift begins, because a rotation while the fingers still close is not a
    slip. If the time of the lift is not known, the lift begins when the contact has settled. A contact
    that was lost for half a second counts as a new grasp.

    Examples:
      rig estimate lift.avi --background first:10 --out lift.csv --page lift.html
      rig estimate sessions/2026-11-21T093000_trial/lifts/001.mcap --sensor D20273
      rig estimate lift.avi --background first:10 --lift-from 2.4
      rig estimate frames/ --timestamps times.csv --reference-time 1.25
      rig estimate frames/ --background empty.png --estimator ellipse --json
      rig estimate bag/ --topic /digit_left/image_raw/compressed
      rig estimate TactileTracking/key0 --out key0.csv
    """
    from rig.frames.estimates import Estimation
    from rig.sessions.files import is_recording
    from rig.sessions.manifest import is_session
    from rig.tactile.estimators import choose_estimator

    frames, out = options.frames, options.out
    of_session, of_recording = is_session(frames), is_recording(frames)
    choice = choose_estimator(options.estimator, options.window, gel=options.gel)
    run = Estimation(
        choice, options.background, options.reference_time, options.lift_from, options.pixel_aspect
    )
    if of_session or of_recording:
        if options.timestamps is not None or options.fps is not None or run.lift is not None:
            raise InputError(f"{frames} contains its times: leave --timestamps, --fps and --lift-from out")
        if options.gel is not None:
            raise InputError(f"{frames} is of several sensors: leave --gel out, or give frames of one")
        if options.topic is not None:
            raise InputError(f"{frames} is not a ROS bag: leave --topic out, or give --sensor")
    folder_place(out if of_session else out and out.parent)  # created if it is missing
    if of_session:
        _session(options, run)
    elif of_recording:
        _recording(options, run)
    else:
        _series(options, run)


def _series(options: EstimateOptions, run: "Estimation") -> None:
    """Estimate frames that are not from a session."""
    from rig.frames.estimates import read_scale, rows
    from rig.frames.series import read_frames

    path = options.frames
    if options.sensor is not None:
        raise InputError(f"{path} is a clip of one sensor: leave --sensor out")
    mm_per_px = None if options.gel is None else read_scale(options.gel)
    begin_phase(f"reading {path}")
    series = read_frames(path, options.timestamps, options.fps, options.topic)
    begin_phase(f"estimating with {run.choice.name}")
    done = run.of_series(series)
    figures = report_estimate(f"{mark(series.simulated)}{path}", done, run)
    _deliver(options, run, rows(done.estimate, mm_per_px), figures, [done], series.simulated)


def _recording(options: EstimateOptions, run: "Estimation") -> None:
    from rig.frames.estimates import rows
    from rig.frames.of_session import of_sensor, recording_frames
    from rig.sessions.recording_file import recording_values

    path = options.frames
    shown, samples, figures = [], [], []
    tips = of_sensor(recording_frames(path), options.sensor)
    for tip, done in zip(tips, estimate_all(run, tips), strict=True):
        shown.append(done)
        samples += [{**row, "sensor": tip.serial} for row in rows(done.estimate)]
        report = report_estimate(f"{path}, {tip.serial}", done, run)
        figures.append({"serial": tip.serial, "sign": tip.sign, **report})
    simulated = recording_values(path).get("simulated") == "SIMULATED"
    _deliver(options, run, samples, {"recording": str(path), "sensors": figures}, shown, simulated)


def _session(options: EstimateOptions, run: "Estimation") -> None:
    from rig.frames.estimates import rows, table
    from rig.frames.of_session import of_sensor, session_frames

    path, out = options.frames, options.out
    if options.page is not None:
        raise InputError(f"--page {options.page}: the page of a session is its report: rig report {path}")
    if out is None:
        raise InputError(f"{path} is a session: give --out FOLDER for one table per lift and sensor")
    lifts, faults = [], []
    tips, problems = session_frames(path)
    tips = of_sensor(tips, options.sensor)
    for tip, done in zip(tips, estimate_all(run, tips), strict=True):
        file = out / f"{tip.lift}_{tip.serial}.csv"
        _write(file, table(rows(done.estimate)))
        figures = report_estimate(f"lift {tip.lift}, {tip.serial}", done, run)
        faults += [done.faults] if done.faults else []
        lifts.append({"lift": tip.lift, "serial": tip.serial, "sign": tip.sign, **figures, "out": str(file)})
    if options.json:
        emit_json({"session": str(path), "out": str(out), "lifts": lifts})
    report_broken(problems)
    report_faults(faults)


def estimate_all(run: "Estimation", tips: "Sequence[SessionSeries]") -> "Iterator[EstimatedSeries]":
    """Yield the estimate of each fingertip in order, computed on all cores."""
    from drivers.realtime import compute_in_one_thread
    from rig.experiments.process_pool import run_in_order

    def begin() -> None:
        end_phase(wait=True)  # workers are forks, which must not copy a thread
        begin_phase(f"estimating with {run.choice.name}", ticking=False)

    begin()
    compute_in_one_thread()
    run.choice.try_making()  # loads the loops once, not in each process
    for done in run_in_order(run.of_series, tips, os.cpu_count() or 1):
        yield done
        begin()  # the caller has printed a result


def _deliver(
    options: EstimateOptions,
    run: "Estimation",
    samples: list[dict[str, object]],
    figures: dict[str, object],
    shown: "list[EstimatedSeries]",
    simulated: bool,
) -> None:
    """Write the table and the page; with --json and without --out put the rows in the JSON."""
    from rig.frames.estimates import table

    out, page = options.out, options.page
    if out is not None:
        _write(out, table(samples))
    elif not options.json:
        print(table(samples), end="")
    if options.json:
        emit_json({**figures, **({"samples": samples} if out is None else {"out": str(out)})})
    if page is not None:
        from rig.report.own_frames import estimate_page
        from rig.report.write import write_page

        backgrounds = ", ".join(dict.fromkeys(one.background for one in shown))
        begin_phase("writing the page")
        about = f"Estimator {run.choice.name}; {backgrounds}."
        write_page(page, estimate_page(shown, options.frames.name, about, simulated))
        say(f"page: {page}")
    report_faults(one.faults for one in shown if one.faults)


def _write(file: Path, text: str) -> None:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror}): choose another --out") from error
    say(f"{plural(text.count(chr(10)) - 1, 'row')} written to {file}")


def report_estimate(what: str, done: "EstimatedSeries", run: "Estimation") -> dict[str, object]:
    """Print the notes, warnings and figures of an estimated series; return the figures."""
    warnings, faults = done.warnings, done.faults
    say(f"{what}: {run.choice.name}")
    for text in (
        *done.frames.notes, done.background, *done.lines(), *(f"warning: {warning}" for warning in warnings)
    ):  # fmt: skip
        for line in wrap(
            text, _LINE_WIDTH, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
        ):
            say(f"  {line}")
    settings = {"estimator": run.choice.name, "window": run.choice.window, "background": done.background}
    about = {"frames_from": what, **settings, "angles_from": done.angles_from}
    return {**about, **asdict(done.figures), "warnings": [*warnings, *([str(faults)] if faults else [])]}


@dataclass(frozen=True, slots=True)
class ExplainOptions:
    frames: Path = argument(..., "Folder of images (sorted by name), video, ROS bag, or session of a trial.")
    out: Path = option(..., "PNG file to write.", callback=file_place)
    background: str | None = option(None, "Frame without contact, as in rig estimate.")
    topic: TopicOption = None
    lift: int = option(1, "Number of the lift in a session.", min=1)
    serial: str | None = option(None, "Serial of the sensor in a session. Default: the first.")
    pixel_aspect: float | None = option(
        None, "Width of a pixel on the gel divided by its height. Default: 1.", min=0.5, max=2.0
    )
    json: JsonOption = False


def explain(options: ExplainOptions) -> None:
    """Draw how the estimator slip finds an angle, on the two frames with the largest rotation between them.

    The first row shows the features of the frame of angle zero: its difference from the frame without
    contact, its texture, weighted by the network, and the curvature of the gel. The second row shows the
    frame, the slopes of its gel surface, and these slopes turned by the estimated angle. The third row shows
    the frame with the largest angle, its slopes, and the difference from the turned slopes, which the
    rotation does not explain. Hue is a direction, brightness a steepness or strength; in the first and last
    picture of the first row grey is 0.

    Examples:
      rig explain frames/ --background empty.png --out stages.png
      rig explain sessions/2026-11-21T093000_trial --lift 3 --out stages.png
    """
    from drivers.images import encode_png
    from rig.frames.stages import explained_frames, explained_lift, stages_picture
    from rig.sessions.files import write_file
    from rig.sessions.manifest import is_session

    if is_session(options.frames):
        if (options.background, options.pixel_aspect, options.topic) != (None, None, None):
            own = "--background, --pixel-aspect and --topic"
            raise InputError(f"{options.frames} is a session: leave {own} out")
        turn = explained_lift(options.frames, options.lift, options.serial)
    else:
        turn = explained_frames(options.frames, options.background, options.pixel_aspect, options.topic)
    write_file(options.out, encode_png(stages_picture(turn)))
    turned = f"turned by {turn.angle_deg:+.2f} deg (image angle) in {turn.apart_s:.2f} s"
    say("\n".join([*turn.notes, turned]))
    figures = {"picture": str(options.out), "angle_deg": turn.angle_deg, "sigma_deg": turn.sigma_deg}
    print_result(options.json, figures, options.out)
