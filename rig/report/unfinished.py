"""An interrupted lift for a film: its curves up to the end of its unfinished recording."""

from dataclasses import dataclass
from pathlib import Path

from drivers.clock import NS_PER_S
from drivers.errors import SessionError
from protocols.observer import Phase
from rig.experiments.interrupted import InterruptedLift, read_interrupted
from rig.experiments.lift_plan import trial_of
from rig.report.curves import LiftCurves
from rig.report.session import curve
from rig.sessions.manifest import TrialManifest
from rig.sessions.recorder import FUSED_TOPIC, TRUTH_TOPIC, slip_topic
from rig.sessions.unfinished import unfinished_recordings


@dataclass(frozen=True, slots=True, eq=False)
class UnfinishedLift:
    """An interrupted lift for a film, see `rig.report.session.Lift`.

    zero_ns: start of phase B by the recording's clock, or of the last phase if B was not reached.
    """

    recording: str
    name: str
    zero_ns: int
    curves: LiftCurves
    gaps: tuple[str, ...]


def find_unfinished(folder: Path, manifest: TrialManifest, wanted: str) -> UnfinishedLift | None:
    """Find an unfinished recording by its file name, such as "007.unfinished"; None if there is none.

    Raises `SessionError` if it contains no angle, and `EstimatorError` like `require_named`.
    """
    name = wanted.strip().removesuffix(".mcap")
    path = next((path for path in unfinished_recordings(folder) if path.stem == name), None)
    if path is None:
        return None
    settings = trial_of(folder, manifest).settings
    settings.estimator.require_named()
    return _shown(path, read_interrupted(path, settings), manifest)


def _shown(path: Path, lift: InterruptedLift, manifest: TrialManifest) -> UnfinishedLift:
    if Phase.GRASP not in lift.phases_ns:
        raise SessionError(f"{path}: the lift was interrupted before phase A: there is no angle to show")
    zero_ns = lift.phases_ns.get(Phase.LIFT, max(lift.phases_ns.values()))
    zero_s = zero_ns / NS_PER_S
    name = f"{lift.name} (unfinished)"
    curves = LiftCurves(
        name,
        curve(lift.angles.get(FUSED_TOPIC, []), zero_s),
        curve(lift.angles.get(TRUTH_TOPIC, []), zero_s),
        phases_s={phase: time_ns / NS_PER_S - zero_s for phase, time_ns in lift.phases_ns.items()},
        tips={serial: curve(lift.angles.get(slip_topic(serial), []), zero_s) for serial in manifest.signs},
    )
    return UnfinishedLift(lift.recording, name, zero_ns, curves, lift.gaps)
