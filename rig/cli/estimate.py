"""`rig estimate`: the angle of the contact in anyone's tactile frames."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli import common
from rig.cli.common import JsonOption

if TYPE_CHECKING:
    from drivers.types import Image
    from rig.frames.estimates import Estimate
    from rig.frames.series import FrameSeries
    from rig.tactile.estimators import EstimatorChoice


def estimate(
    frames: Annotated[
        Path, typer.Argument(help="Folder of images (sorted by name), image, video file or session folder.")
    ],
    background: Annotated[
        str | None,
        typer.Option(
            help="Frame without contact: an IMAGE, first:N (mean of the first N frames) or auto (made from "
            "the frames themselves). Default: a session's own; else auto, from nine frames on."
        ),
    ] = None,
    timestamps: Annotated[
        Path | None,
        typer.Option(help="CSV with columns frame,t_s (frame: file name, stem or number from 0)."),
    ] = None,
    fps: Annotated[
        float | None, typer.Option(help="Frame rate in Hz. Default: a video's own; images 60.")
    ] = None,
    reference_time: Annotated[
        str | None,
        typer.Option(
            help="Time in s whose angle is zero. Default: the first frame of stable full contact (area "
            "within 5 % over the next 5 frames and at least 80 % of its later level)."
        ),
    ] = None,
    estimator: Annotated[
        str | None,
        typer.Option(
            help="slip, skeleton, ellipse, pca; the last three also with -published; ecc, polar; "
            "kolamuri (for a gel with printed markers), anglenet (a network trained on simulated lifts). "
            "Default: slip."
        ),
    ] = None,
    window: Annotated[
        int | None,
        typer.Option(
            min=1, max=100, help="Mean over the last n angles; 2 for the paper's methods, none for slip."
        ),
    ] = None,
    pixel_aspect: Annotated[
        float | None,
        typer.Option(
            min=0.5,
            max=2.0,
            help="Width over height of a pixel on the gel, as `rig calibrate tactile` finds it. "
            "Default: a session's own; else unknown, taken as 1 with a larger sigma.",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="CSV file, or folder for a session. Default: the table on stdout.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Estimate how the contact turns in tactile images: a row `t_s,angle_deg,sigma_deg,state` per frame.

    Angles are image angles, counter-clockwise positive as seen; a session's are the object's. A
    field is empty where the estimator refuses. With --json and no --out the rows are in the JSON.

    Examples:
      rig estimate lift.avi --background first:10 --out lift.csv

      rig estimate frames/ --timestamps times.csv --reference-time 1.25

      rig estimate frames/ --background empty.png --estimator ellipse --json

    """
    from rig.sessions.manifest import is_session
    from rig.tactile.estimators import choose_estimator

    run = _Run(background, reference_time, choose_estimator(estimator, window), pixel_aspect)
    if is_session(frames):
        _session(frames, run, timestamps, fps, out, json)
    else:
        _series(frames, run, timestamps, fps, out, json)


class _Run:
    """One choice of estimator and background, applied to series after series."""

    def __init__(
        self,
        background: str | None,
        reference_time: str | None,
        choice: "EstimatorChoice",
        aspect: float | None,
    ) -> None:
        from drivers.errors import InputError
        from rig.frames.times import parse_time
        from rig.tactile.estimators import PUBLISHED, TOSKOV

        if choice.name == TOSKOV:
            raise InputError(
                f"the estimator '{TOSKOV}' feels at the arm's wrist and frames do not tell that: use it in "
                f"lifts, with rig trial, or rig replay SESSION --estimator {TOSKOV}"
            )
        self.background, self.choice, self.aspect = background, choice, aspect
        self.published = choice.name.endswith(PUBLISHED)
        self.reference = None if reference_time is None else parse_time(reference_time)
        if reference_time is not None and self.reference is None:
            raise InputError(f"--reference-time '{reference_time}' is not a time in s")
        if self.published and self.reference is not None:
            raise InputError(
                f"{choice.name} takes its zero itself, as the script does: leave --reference-time out"
            )

    def apply(
        self,
        series: "FrameSeries",
        own: "Image | None" = None,
        sign: int = 1,
        own_aspect: float | None = None,
    ) -> tuple["Estimate", str]:
        """Estimate a series, own being what its session knows of the sensor.

        Returns the estimate and a note on its background.
        """
        from rig.frames.estimates import estimate_series, zeroed
        from rig.frames.series import make_background

        for note in series.notes:
            common.say(note)
        if own is not None and self.background is None:
            background, note = own, "background: the session's own"
        else:
            background, note = make_background(self.background, series)
        answers = estimate_series(series, self.choice.make(background, self.aspect or own_aspect))
        return zeroed(answers, self.reference, self.published, 1 if self.published else sign), note


def _series(
    path: Path, run: _Run, timestamps: Path | None, fps: float | None, out: Path | None, json: bool
) -> None:
    """Estimate frames that are no session."""
    from rig.frames.estimates import rows, table
    from rig.frames.series import read_frames

    result, note = run.apply(read_frames(path, timestamps, fps))
    if out is not None:
        _write(out, table(result))
    elif not json:
        print(table(result), end="")
    figures = _report(str(path), result, note, run)
    if json:
        samples = {"samples": rows(result)} if out is None else {"out": str(out)}
        common.emit_json({**figures, **samples})


def _session(
    path: Path, run: _Run, timestamps: Path | None, fps: float | None, out: Path | None, json: bool
) -> None:
    """Estimate each lift and sensor of a session into a file of its own."""
    from drivers.errors import InputError
    from rig.frames.estimates import table
    from rig.frames.of_session import session_frames

    if timestamps is not None or fps is not None:
        raise InputError(f"{path} is a session, which has its own times: leave --timestamps and --fps out")
    if out is None:
        raise InputError(f"{path} is a session: give --out FOLDER for one table per lift and sensor")
    lifts = []
    tips, problems = session_frames(path)
    for tip in tips:
        result, note = run.apply(tip.frames, tip.background, tip.sign, tip.aspect)
        file = out / f"{tip.lift}_{tip.serial}.csv"
        _write(file, table(result))
        figures = _report(f"lift {tip.lift}, {tip.serial}", result, note, run)
        lifts.append({"lift": tip.lift, "serial": tip.serial, "sign": tip.sign, **figures, "out": str(file)})
    if json:
        common.emit_json({"session": str(path), "out": str(out), "lifts": lifts})
    common.report_broken(problems)


def _write(file: Path, text: str) -> None:
    from drivers.errors import InputError

    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror}): choose another --out") from error


def _report(what: str, result: "Estimate", background_note: str, run: _Run) -> dict[str, object]:
    """Say the summary on stderr and return it for JSON."""
    from dataclasses import asdict

    from rig.frames.estimates import figures

    found = figures(result)
    if found.unreadable:
        common.say(f"warning: {found.unreadable} frames could not be read; their rows say 'lost'")
    if found.jumped:
        common.say(
            f"warning: the times of {found.jumped} frames jump from those around them; their rows say 'lost'"
        )
    refused = ", ".join(f"{count} {state}" for state, count in found.refused.items()) or "none"
    zero = "" if result.zero is None else f"{result.zero.text} s, "
    common.say(background_note)
    common.say(
        f"{what}: {run.choice.name}, {found.frames} frames, {found.answered} answered, "
        f"refused: {refused}; zero at {zero}{found.reference}; "
        f"{found.median_ms} ms per frame (p99 {found.p99_ms})"
    )
    settings = {"estimator": run.choice.name, "window": run.choice.window, "background": background_note}
    return {"frames_from": what, **settings, **asdict(found)}
