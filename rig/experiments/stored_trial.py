"""A finished trial as the input of a replay: its manifest, read once, and the settings to measure it with."""

from dataclasses import dataclass
from pathlib import Path

from rig.experiments.lift_plan import TrialSettings
from rig.lift.marker_truth import TRUTH
from rig.lift.slip_watch import SlipSettings
from rig.sessions.manifest import TrialManifest, read_manifest_of
from rig.tactile.estimators import EstimatorChoice, choose_estimator, stored_choice


@dataclass(frozen=True, slots=True)
class StoredTrial:
    """A trial's folder, its manifest, and the settings of a replay.

    settings: those of the trial, or with another estimator.
    """

    folder: Path
    manifest: TrialManifest
    settings: TrialSettings

    @property
    def own_estimator(self) -> bool:
        """Whether the settings have the estimator of the trial itself."""
        stored = self.manifest
        return self.settings.estimator == stored_choice(stored.estimator, stored.window, stored.skip)

    @property
    def repeats(self) -> bool:
        """Whether a replay is expected to give exactly the stored results."""
        return self.own_estimator and self.truth_note is None

    @property
    def truth_note(self) -> str | None:
        """How a replay measures the true angles differently; None if it measures them in the same way."""
        truth = self.manifest.truth
        if truth == TRUTH:
            return None
        return (
            f"true angles were measured by the markers' {truth}, a replay measures them by their {TRUTH}: "
            "errors differ by some hundredths of a degree; the stored rows stay as they are"
        )


def stored_trial(folder: Path, estimator: str | None = None, window: int | None = None) -> StoredTrial:
    """Read a trial's manifest and choose the estimator as `trial_of` does. Raises `SessionError`."""
    manifest = read_manifest_of(folder, TrialManifest, "only trials have lifts to replay")
    return trial_of(folder, manifest, estimator, window)


def trial_of(
    folder: Path, manifest: TrialManifest, estimator: str | None = None, window: int | None = None
) -> StoredTrial:
    """Return a trial with the settings of a replay. estimator, window: those of the trial if None.

    A user-defined estimator is imported only if it is named here. If only the session names it,
    `settings.estimator` cannot be created. Raises `InputError` for an unknown estimator or window.
    """
    settings = TrialSettings(
        manifest.config,
        manifest.seed,
        _choice(manifest, estimator, window),
        react=manifest.react,
        slip=SlipSettings(manifest.false_alarms_per_hour, manifest.max_turn_deg),
    )
    return StoredTrial(folder, manifest, settings)


def _choice(manifest: TrialManifest, estimator: str | None, window: int | None) -> EstimatorChoice:
    """Return the session's own estimator, or another one with its usual window."""
    if estimator is None:
        return stored_choice(manifest.estimator, window or manifest.window, manifest.skip)
    if estimator == manifest.estimator:
        return choose_estimator(estimator, window or manifest.window, manifest.skip)
    return choose_estimator(estimator, window)
