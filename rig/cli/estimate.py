"""`rig estimate`: the angle of the contact in anyone's tactile frames."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import InputError
from rig.cli.common import emit_json, report_broken, say
from rig.cli.declared import argument, option
from rig.cli.options import JsonOption, TopicOption
from rig.cli.places import file_place, folder_place

if TYPE_CHECKING:
    from rig.frames.estimation import EstimatedSeries, Estimation, SeriesEstimate


@dataclass(frozen=True, slots=True)
class SourceOptions:
    """The frames, and their times."""

    frames: Path = argument(
        ...,
        "Folder of images (sorted by name), image, video (.avi, .mp4, .mkv, .webm ...), array "
        "(.npy or .npz: T, H, W, 3, uint8, RGB), ROS bag, recording of a lift (.mcap) or session folder; "
        "a trial of TactileTracking, or bag_00.pkl:FINGER of digit-pose-estimation.",
    )
    sensor: str | None = option(
        None, "Of a recording or session: serial of one fingertip. Default: all fingertips."
    )
    timestamps: Path | None = option(
        None, "CSV with columns frame,t_s (frame: file name, stem or number from 0)."
    )
    fps: float | None = option(None, "Frame rate in Hz. Default: a video's own; images 60.")
    topic: TopicOption = None


@dataclass(frozen=True, slots=True)
class EstimationOptions:
    """How the frames are estimated."""

    background: str | None = option(
        None,
        "Frame without contact: an IMAGE, first:N (mean of the first N frames) or auto (made from "
        "all frames, for contacts that move about). Default: a session's own; else the first frames if "
        "they are alike and later ones differ, or the image that most frames share; refused if neither "
        "shows an untouched gel.",
    )
    reference_time: str | None = option(
        None,
        "Time in s whose angle is zero; without an angle there, the first answer from there on. "
        "Default: the first frame of stable full contact (area within 5 % over the next 5 frames and "
        "at least 80 % of its later level).",
    )
    lift_from: str | None = option(
        None,
        "Time in s at which the lift begins, which arms the slip alarm. Default: a session's own; "
        "else when each contact has stopped growing (area within 5 % over 6 frames).",
    )
    estimator: str | None = option(
        None,
        "slip, skeleton, ellipse, pca; the last three also with -published; ecc, polar; "
        "kolamuri (for a gel with printed markers), anglenet (a network trained on simulated lifts); "
        "or your own, as package.module:Class (rig estimators). Default: slip.",
    )
    window: int | None = option(
        None, "Mean over the last n angles; 2 for the paper's methods, none for slip.", min=1, max=100
    )
    pixel_aspect: float | None = option(
        None,
        "Width over height of a pixel on the gel, as `rig calibrate tactile` finds it. "
        "Default: a session's own; else unknown, taken as 1 with a larger sigma.",
        min=0.5,
        max=2.0,
    )


@dataclass(frozen=True, slots=True)
class ResultOptions:
    """Where the result goes."""

    out: Path | None = option(None, "CSV file, or folder for a session. Default: the table on stdout.")
    page: Path | None = option(
        None,
        "Also an HTML page: the curve with its sigma band and states, and frames with the contact.",
        callback=file_place,
    )
    json: JsonOption = False


def estimate(source: SourceOptions, how: EstimationOptions, to: ResultOptions) -> None:
    """Estimate how the contact turns in tactile images: a row per frame.

    Columns: t_s; angle_deg and sigma_deg, from the zero; state; rate_deg_s; shift_x_px and shift_y_px, how
    far the contact has moved since the zero, right and down; slip, 1 from the slip alarm on; for a recording
    also sensor. Angles are image angles, counter-clockwise positive as seen; those of a recording or session
    are the object's. A field is empty if the estimator refuses or does not report it. With --json and no
    --out the rows are in the JSON.

    The lift arms the alarm: a turn while the fingers still close is no slip. If the time of the lift is
    not known, a contact that has stopped growing stands for it, and one that was gone for half a second
    is a new grasp.

    Examples:
      rig estimate lift.avi --background first:10 --out lift.csv --page lift.html

      rig estimate sessions/2026-11-21T093000_trial/lifts/001.mcap --sensor D20273

      rig estimate lift.avi --background first:10 --lift-from 2.4

      rig estimate frames/ --timestamps times.csv --reference-time 1.25

      rig estimate frames/ --background empty.png --estimator ellipse --json

      rig estimate bag/ --topic /digit_left/image_raw/compressed

      rig estimate TactileTracking/key0 --out key0.csv

    """
    from rig.sessions.files import is_recording
    from rig.sessions.manifest import is_session

    frames = source.frames
    of_session, of_recording = is_session(frames), is_recording(frames)
    run = _run(source, how, of_session or of_recording)
    folder_place(to.out if of_session else to.out and to.out.parent)  # created if it is missing
    if of_session:
        _session(source, run, to)
    elif of_recording:
        _recording(source, run, to)
    else:
        _series(source, run, to)


def _run(source: SourceOptions, how: EstimationOptions, of_rig: bool) -> "Estimation":
    """Return what is asked of every series. of_rig: whether the frames have times. Raises `InputError`."""
    from rig.frames.estimation import Estimation
    from rig.tactile.estimators import choose_estimator

    choice = choose_estimator(how.estimator, how.window)
    run = Estimation(choice, how.background, how.reference_time, how.lift_from, how.pixel_aspect)
    if of_rig and (source.timestamps is not None or source.fps is not None or run.lift is not None):
        raise InputError(f"{source.frames} has its own times: leave --timestamps, --fps and --lift-from out")
    if of_rig and source.topic is not None:
        raise InputError(f"{source.frames} is not a ROS bag: leave --topic out, or choose a --sensor")
    return run


def _series(source: SourceOptions, run: "Estimation", to: ResultOptions) -> None:
    """Estimate frames that are no session."""
    from rig.frames.estimates import rows
    from rig.frames.estimation import EstimatedSeries
    from rig.frames.series import read_frames
    from rig.live.screen import begin_phase

    path = source.frames
    if source.sensor is not None:
        raise InputError(f"{path} is a clip of one sensor: leave --sensor out")
    begin_phase(f"reading {path}")
    series = read_frames(path, source.timestamps, source.fps, source.topic)
    for note in series.notes:
        say(note)
    begin_phase(f"estimating with {run.choice.name}")
    done = run.of_series(series)
    figures = _report(str(path), done, run)
    _deliver(rows(done.estimate), figures, to)
    _page(to.page, [EstimatedSeries(path.name, series, done)], path, run)


def _recording(source: SourceOptions, run: "Estimation", to: ResultOptions) -> None:
    """Estimate the fingertips of one recording into one table."""
    from rig.frames.estimates import rows
    from rig.frames.estimation import EstimatedSeries
    from rig.frames.of_session import of_sensor, recording_frames
    from rig.sessions.recording_file import recording_values

    path = source.frames
    shown, samples, figures = [], [], []
    for tip in of_sensor(recording_frames(path), source.sensor):
        done = run.of_sensor(tip)
        shown.append(EstimatedSeries(tip.serial, tip.frames, done, tip.sign))
        samples += [{**row, "sensor": tip.serial} for row in rows(done.estimate)]
        report = _report(f"{path}, {tip.serial}", done, run)
        figures.append({"serial": tip.serial, "sign": tip.sign, **report})
    _deliver(samples, {"recording": str(path), "sensors": figures}, to)
    _page(to.page, shown, path, run, recording_values(path).get("simulated") == "SIMULATED")


def _session(source: SourceOptions, run: "Estimation", to: ResultOptions) -> None:
    """Estimate each lift and sensor of a session into a file of its own."""
    from rig.frames.estimates import rows, table
    from rig.frames.of_session import of_sensor, session_frames

    path, out = source.frames, to.out
    if to.page is not None:
        raise InputError(f"--page {to.page}: the page of a session is its report: rig report {path}")
    if out is None:
        raise InputError(f"{path} is a session: give --out FOLDER for one table per lift and sensor")
    lifts = []
    tips, problems = session_frames(path)
    for tip in of_sensor(tips, source.sensor):
        done = run.of_sensor(tip)
        file = out / f"{tip.lift}_{tip.serial}.csv"
        _write(file, table(rows(done.estimate)))
        figures = _report(f"lift {tip.lift}, {tip.serial}", done, run)
        lifts.append({"lift": tip.lift, "serial": tip.serial, "sign": tip.sign, **figures, "out": str(file)})
    if to.json:
        emit_json({"session": str(path), "out": str(out), "lifts": lifts})
    report_broken(problems)


def _deliver(samples: list[dict[str, object]], figures: dict[str, object], to: ResultOptions) -> None:
    """Write the table to its file or to stdout; with JSON and no file the rows are in the JSON."""
    from rig.frames.estimates import table

    if to.out is not None:
        _write(to.out, table(samples))
    elif not to.json:
        print(table(samples), end="")
    if to.json:
        emit_json({**figures, **({"samples": samples} if to.out is None else {"out": str(to.out)})})


def _page(
    page: Path | None,
    shown: "list[EstimatedSeries]",
    source: Path,
    run: "Estimation",
    simulated: bool = False,
) -> None:
    if page is None:
        return
    from rig.report.own_frames import estimate_page
    from rig.report.write import write_page

    about = f"Estimator {run.choice.name}; {', '.join(dict.fromkeys(one.done.background for one in shown))}."
    write_page(page, estimate_page(shown, source.name, about, simulated))
    say(f"page: {page}")


def _write(file: Path, text: str) -> None:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror}): choose another --out") from error


def _report(what: str, done: "SeriesEstimate", run: "Estimation") -> dict[str, object]:
    """Say the summary on stderr and return it for JSON."""
    from dataclasses import asdict

    for warning in done.warnings:
        say(f"warning: {warning}")
    say(done.background)
    say(f"{what}: {run.choice.name}, {done.text}")
    settings = {"estimator": run.choice.name, "window": run.choice.window, "background": done.background}
    about = {"frames_from": what, **settings, "angles_from": done.angles_from}
    return {**about, **asdict(done.figures), "warnings": done.warnings}
