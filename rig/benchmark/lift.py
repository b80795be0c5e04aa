"""`rig benchmark lift`: the CPU time of simulated lifts and of their report, by parts of the work."""

import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from drivers.realtime import compute_in_one_thread
from rig.benchmark.harness import Report, Run, Study, column, table_of
from rig.config import load_bench
from rig.declared import option
from rig.experiments.lift_plan import TrialSettings
from rig.experiments.trial import resolve_objects, run_trial
from rig.report.write import write_report
from rig.tactile.estimators import choose_estimator

PARTS = {
    "slip: frames": "rig.tactile.slip.estimator.SlipEstimator._estimate",
    "slip: set-up": "rig.tactile.slip.estimator.SlipEstimator.__init__",
    "copies of pictures": "drivers.tally.PictureNews.add",
    "outlines": "rig.lift.recording.OutlineObserver.frame",
    "markers": "rig.lift.marker_truth.MarkerTruth.update",
    "recording": "rig.sessions.recorder.LiftRecorder.frame",
    "JPEG: encoding": "fakes.devices.camera.encoded",
    "JPEG: decoding": "fakes.devices.camera.decoded",
    "simulated gel": "fakes.gel.sensor.GelSensor.render",
    "simulated gel: set-up": "fakes.gel.sensor.GelSensor.__init__",
    "simulated camera": "fakes.camera.marker_scene.MarkerScene.render",
    "simulated arm": "fakes.devices.arm.FakeArm.state",
    "simulated world": "fakes.world.world.World.state_at",
    "report": "rig.benchmark.lift.write_report",
    "report: films": "rig.report.explored.lift_film",
    "report: strips": "rig.report.trial_page.strip",
    "report: figures": "rig.report.parts.drawn_svg",
}
"""The function that carries out each part of the work."""
REST = "everything else"


@dataclass(frozen=True, slots=True)
class LiftOptions:
    objects: list[str] | None = option(
        None, "Id or name; repeat for more. Default: the trial's nine.", "--object"
    )
    lifts: int = option(1, "Lifts of each object.", min=1, max=100)


@dataclass(frozen=True, slots=True)
class Share:
    """The work of one part, per lift."""

    part: str = column("part")
    share: float = column("share", ".1%")
    cpu_s: float = column("CPU, s", ".3f", "per lift, without the other parts that it calls")
    calls: float = column("calls", ".0f", "per lift")
    ms: float | None = column("ms per call", ".2f")
    function: str = column("function")


@contextmanager
def metered(parts: Mapping[str, str]) -> Iterator[tuple[dict[str, float], Counter[str]]]:
    """Yield the CPU time of this thread, s, and the calls of each part; both are complete after the block.

    The time of a part does not include that of other parts that it calls.
    """
    spent_s, calls, inside = defaultdict[str, float](float), Counter[str](), [REST]
    since_s = time.thread_time()

    def lap() -> None:
        nonlocal since_s
        since_s, before_s = time.thread_time(), since_s
        spent_s[inside[-1]] += since_s - before_s

    def measured(part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def measured(*args: Any, **options: Any) -> Any:
            lap()
            inside.append(part)
            calls[part] += 1
            try:
                return function(*args, **options)
            finally:
                lap()
                inside.pop()

        return measured

    with ExitStack() as stack:
        for part, name in parts.items():
            owner, _, last = name.rpartition(".")
            place: Any = resolve_name(owner)
            stack.callback(setattr, place, last, getattr(place, last))
            setattr(place, last, measured(part, getattr(place, last)))
        yield spent_s, calls
    lap()


def measure(options: LiftOptions, run: Run) -> Report:
    """Print the CPU time of SIMULATED lifts and their report, by part of the work.

    All lifts are carried out in this process, and then deleted.

    Examples:
      rig benchmark lift
      rig benchmark lift --object wrench --lifts 5
    """
    compute_in_one_thread()
    settings = TrialSettings(load_bench("fake"), run.seed, choose_estimator())
    objects = resolve_objects(options.objects)
    with tempfile.TemporaryDirectory(prefix="rig_lift_") as folder, metered(PARTS) as (spent_s, calls):
        run_trial(
            Path(folder), settings, objects, options.lifts,
            progress=lambda done, total, row: run.progress(done, total, row.title),
        )  # fmt: skip
        write_report([Path(folder)])
    lifts, all_s, rows = len(objects) * options.lifts, sum(spent_s.values()), []
    for part, cpu_s in sorted(spent_s.items(), key=lambda part: -part[1]):
        ms = 1e3 * cpu_s / calls[part] if calls[part] else None
        function = ".".join(PARTS.get(part, "").split(".")[-2:])
        rows.append(Share(part, cpu_s / all_s, cpu_s / lifts, calls[part] / lifts, ms, function))
    table = table_of(f"SIMULATED: CPU time of {lifts} lifts and their report, per lift", rows)
    return Report((table,), section=f"{table.title}.\n\n{table.markdown()}")


STUDY = Study("lift", LiftOptions, measure, "lifts", ("readme", "seed"))
