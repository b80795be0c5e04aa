"""`rig benchmark trials`: the paper's Tables III and IV on the same simulated lifts in one run."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from drivers.errors import InputError
from protocols.grasps import TRIAL_OBJECTS
from rig.benchmark.estimators.benchmark import Progress
from rig.benchmark.estimators.lifts import session_lifts
from rig.benchmark.estimators.scores import ContenderScore, score_all
from rig.benchmark.harness import machine
from rig.benchmark.trials.passes import TrialPass, pass_lift
from rig.benchmark.trials.systems import ANGLENET_ON_TEST, PEER_FILES, PLAIN
from rig.config import load_bench
from rig.config.models import BenchConfig
from rig.experiments.lift_attempt import TrialSettings
from rig.experiments.trial import run_trial
from rig.sessions.manifest import is_session
from rig.sessions.records import LiftRow
from rig.tactile.estimators import DEFAULT_ESTIMATOR, KOLAMURI, choose_estimator

SCHEMA = 1
LIFTS = 5
NETWORKS = {"deeplabv3plus": "DeepLabV3+", "unetplusplus": "UNet++", "pspnet": "PSPNet"}
"""The paper's networks by their names of `rig train`, in its order."""
OURS = "ours"
PLAIN_SESSION, MARKED_SESSION = "session", "session-markers"


@dataclass(frozen=True, slots=True)
class TrialsSettings:
    """What to run.

    models: files of networks by name, beside the shipped ones. jobs: worker processes that record;
    the pass itself has one, so that times can be compared.
    """

    out: Path
    seed: int = 0
    jobs: int = 2
    lifts: int = LIFTS
    objects: tuple[str, ...] = TRIAL_OBJECTS
    models: Mapping[str, Path] = field(default_factory=dict)

    def networks(self) -> dict[str, str]:
        """Return the networks that there are: shipped name or file by title."""
        known = {"pspnet": "pspnet", OURS: OURS, **{name: str(file) for name, file in self.models.items()}}
        titles = {**NETWORKS, OURS: OURS}
        return {title: known[name] for name, title in titles.items() if name in known}

    def systems(self) -> tuple[str, ...]:
        """Return the systems that run on the plain gel's lifts."""
        return (*PLAIN, *((ANGLENET_ON_TEST,) if ANGLENET_ON_TEST in self.models else ()))


@dataclass(frozen=True, slots=True)
class TrialsResult:
    """Everything measured on the simulated lifts. scores: by method and window, over phase B.

    ms: median wall time per frame by method, one thread. frames: of phase B. missing: names of
    networks of the paper that were not given.
    """

    settings: TrialsSettings
    lifts: int
    frames: int
    scores: dict[tuple[str, int], ContenderScore]
    ms: dict[str, float]
    missing: tuple[str, ...]
    wall_s: float


def parse_models(texts: Sequence[str]) -> dict[str, Path]:
    """Return files by network from texts as "unetplusplus=FILE". Raises `InputError`."""
    models = {}
    for text in texts:
        name, _, file = text.partition("=")
        if name not in (*NETWORKS, OURS, *PEER_FILES) or not file:
            names = ", ".join((*NETWORKS, OURS, *PEER_FILES))
            raise InputError(f"--model {text}: give NAME=FILE, NAME being one of {names}")
        if not Path(file).is_file():
            raise InputError(f"--model {text}: there is no file {file}")
        models[name] = Path(file)
    return models


def run_trials(settings: TrialsSettings, progress: Progress = lambda *_: None) -> TrialsResult:
    """Record the lifts, on a plain gel and on one with markers, and run every system over them.

    A run that was interrupted goes on where it was. Raises what `run_trial` and `pass_lift` raise.
    """
    began = time.perf_counter()
    bench = load_bench("fake")
    plain = _recorded(settings, bench, DEFAULT_ESTIMATOR, PLAIN_SESSION, progress)
    marked = _recorded(settings, with_markers(bench), KOLAMURI, MARKED_SESSION, progress)
    passes = _passes(plain, settings, settings.networks(), settings.systems(), partial(progress, "passes"))
    marker_passes = _passes(marked, settings, {}, (KOLAMURI,), partial(progress, "markers"))
    together = [passes, marker_passes]
    return TrialsResult(
        settings=settings,
        lifts=len(passes),
        frames=sum(p.frames for p in passes),
        scores={key: score for part in together for key, score in _scores(part).items()},
        ms={name: ms for part in together for name, ms in _ms(part).items()},
        missing=tuple(n for n, title in NETWORKS.items() if title not in settings.networks()),
        wall_s=time.perf_counter() - began,
    )


def with_markers(bench: BenchConfig) -> BenchConfig:
    """Return the bench with markers printed on its gels, all else alike."""
    tactile = tuple(t.model_copy(update={"markers": True}) for t in bench.tactile)
    return bench.model_copy(update={"tactile": tactile})


def as_json(result: TrialsResult) -> dict[str, object]:
    """Return the result as JSON values, with what it was measured on."""
    return {
        "schema": SCHEMA,
        "simulated": True,
        "seed": result.settings.seed,
        "lifts": result.lifts,
        "frames": result.frames,
        "machine": machine(),
        "systems": [
            {"system": name, "window": window, "ms": result.ms[name], **asdict(score)}
            for (name, window), score in result.scores.items()
        ],
        "not_trained": list(result.missing),
        "wall_s": round(result.wall_s, 1),
    }


def _recorded(
    settings: TrialsSettings, bench: BenchConfig, estimator: str, name: str, progress: Progress
) -> Path:
    folder = settings.out / name
    trial = TrialSettings(bench, settings.seed, choose_estimator(estimator))

    def show(done: int, total: int, row: LiftRow) -> None:
        progress(f"lifts, {name}", done, total, f"{row.object}/{row.lift} {row.outcome}")

    resume = is_session(folder)
    run_trial(folder, trial, list(settings.objects), settings.lifts, settings.jobs, resume, progress=show)
    return folder


def _passes(
    folder: Path,
    settings: TrialsSettings,
    networks: Mapping[str, str],
    systems: Sequence[str],
    show: Callable[[int, int, str], None],
) -> list[TrialPass]:
    tips, rows = session_lifts(folder)
    files = {name: file for name, file in settings.models.items() if name in PEER_FILES}
    passes = []
    for row in rows:
        passes.append(pass_lift(folder, tips, networks, systems, files, row))
        show(len(passes), len(rows), f"{row.object}/{row.lift}")
    return passes


def _scores(passes: Sequence[TrialPass]) -> dict[tuple[str, int], ContenderScore]:
    return {key: score_all([p.scores[key] for p in passes]) for key in passes[0].scores}


def _ms(passes: Sequence[TrialPass]) -> dict[str, float]:
    names = passes[0].frame_s
    return {name: 1e3 * float(np.median(np.concatenate([p.frame_s[name] for p in passes]))) for name in names}
