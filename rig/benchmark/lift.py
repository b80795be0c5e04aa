"""`rig benchmark lift`: the CPU time of simulated lifts and of their report, by parts of the work."""

import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from importlib import import_module
from pathlib import Path
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
    "slip: frames": ("rig.tactile.slip.estimator:SlipEstimator._estimate",),
    "slip: set-up": ("rig.tactile.slip.estimator:SlipEstimator.__init__",),
    "copies of pictures": ("drivers.tally:PictureNews.add",),
    "contact at release": ("protocols.pump:imprint",),
    "outlines": ("rig.lift.recording:OutlineObserver.frame",),
    "markers": tuple(f"rig.lift.marker_truth:MarkerTruth.{of}" for of in ("update", "measure_zero")),
    "result": ("rig.experiments.lift_attempt:lift_result",),
    "recording": tuple(
        f"rig.sessions.recorder:LiftRecorder.{of}" for of in ("frame", "arm", "gripper", "contact", "angles")
    ),
    "JPEG: encoding": ("fakes.devices.camera:encoded",),
    "JPEG: decoding": ("fakes.devices.camera:decoded",),
    "simulated gel": ("fakes.gel.sensor:GelSensor.render",),
    "simulated gel: set-up": ("fakes.gel.sensor:GelSensor.__init__",),
    "simulated camera": ("fakes.camera.marker_scene:MarkerScene.render",),
    "simulated arm": ("fakes.devices.arm:FakeArm.state",),
    "simulated world": tuple(f"fakes.world.world:World.{of}" for of in ("state_at", "object_pose_at")),
    "report": ("rig.benchmark.lift:write_report",),
    "report: reading": ("rig.report.session:_read_lift", "rig.report.explored:recorded_lift"),
    "report: films": ("rig.report.explored:lift_film",),
    "report: strips": ("rig.report.trial_page:strip",),
    "report: figures": ("rig.report.parts:svg",),
}
"""The functions that carry out each part of the work, as MODULE:NAME or MODULE:CLASS.NAME."""
REST, OTHERS = "everything else", "other threads"


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
    functions: str = column("function")


class Meter:
    """Adds up the CPU time of this thread by the part whose function was called last, and counts calls."""

    def __init__(self) -> None:
        self.spent_s, self.calls = Counter[str](), Counter[str]()
        self._inside, self._since_s = [REST], time.thread_time()

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Measure the functions of `PARTS`."""
        places = [(part, *_place(name)) for part, names in PARTS.items() for name in names]
        own = [(owner, name, getattr(owner, name)) for _, owner, name in places]
        try:
            for (part, owner, name), (*_, function) in zip(places, own, strict=True):
                setattr(owner, name, self.measured(part, function))
            yield
        finally:
            for owner, name, function in own:
                setattr(owner, name, function)

    def measured(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function whose time is added to a part."""

        @wraps(function)
        def measured(*args: Any, **options: Any) -> Any:
            self.lap()
            self._inside.append(part)
            self.calls[part] += 1
            try:
                return function(*args, **options)
            finally:
                self.lap()
                self._inside.pop()

        return measured

    def lap(self) -> None:
        """Add the time since the last lap to the innermost part."""
        now_s = time.thread_time()
        self.spent_s[self._inside[-1]] += now_s - self._since_s
        self._since_s = now_s


def _place(name: str) -> tuple[Any, str]:
    """Return the module or class of a function of `PARTS`, and its name there."""
    module, _, inside = name.partition(":")
    owner, _, function = inside.rpartition(".")
    return getattr(import_module(module), owner) if owner else import_module(module), function


def measure(options: LiftOptions, run: Run) -> Report:
    """Carry out SIMULATED lifts, write their report, and print which part of it takes how much CPU time.

    All is done in one process, after the imports; the lifts are deleted.

    Examples:
      rig benchmark lift
      rig benchmark lift --object wrench --lifts 5
    """
    compute_in_one_thread()
    bench, meter = load_bench("fake"), Meter()
    settings = TrialSettings(bench, run.seed, choose_estimator())
    objects = resolve_objects(options.objects or [], bench.objects)
    count = len(objects) * options.lifts
    with tempfile.TemporaryDirectory(prefix="rig_lift_") as folder, meter.installed():
        before_s, meter = time.process_time(), meter
        run_trial(
            Path(folder), settings, objects, options.lifts,
            progress=lambda done, total, row: run.progress(done, total, row.title),
        )  # fmt: skip
        write_report([Path(folder)])
        meter.lap()
        all_s = time.process_time() - before_s
    meter.spent_s[OTHERS] = all_s - meter.spent_s.total()
    rows = [
        Share(part, spent_s / all_s, spent_s / count, calls / count, 1e3 * spent_s / calls if calls else None,
              ", ".join(name.partition(":")[2] for name in PARTS.get(part, ())))
        for part, spent_s in meter.spent_s.most_common()
        if (calls := meter.calls[part]) or True
    ]  # fmt: skip
    return Report((table_of(f"SIMULATED: CPU time of {count} lifts and their report, per lift", rows),))


STUDY = Study("lift", LiftOptions, measure, "lifts", ("seed",))
