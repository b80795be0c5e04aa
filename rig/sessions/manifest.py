"""A session's manifest: what was requested, on which bench, and its state."""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar

from pydantic import ConfigDict, Discriminator, Field, Tag

from drivers.errors import SessionError, no_such
from drivers.formats import quote
from protocols.reaction import ReactionKind
from rig.config import BenchConfig
from rig.config.fields import FileName
from rig.config.measured_values import Calibrations, FileInUse
from rig.config.objects import with_objects_of
from rig.sessions.about import NO_REMARKS, Remarks
from rig.sessions.codec import Codec, json_value, strict
from rig.sessions.files import CALIBRATIONS, MANIFEST, RESULTS, read_whole
from rig.version import VERSION, processor

SCHEMA_VERSION = 2
"""Version of all files in a session folder."""


@strict
@dataclass(frozen=True, kw_only=True)
class Manifest:
    """Fields of every session. started, completed: UTC, to the second. processor: name; "" if unknown."""

    schema_version: int
    tool_version: str
    kind: str
    status: Literal["running", "complete"]
    started: str
    completed: str | None = None
    processor: str = ""


@dataclass(frozen=True, kw_only=True)
class BenchManifest(Manifest):
    """Common fields of trials and recordings: the bench and the random draws on it.

    signs: of the fingertips by serial. calibration: the files in use, by kind and serials; their copies are
    in the folder `CALIBRATIONS`. config: the bench, a lab's own objects included. objects: ids. remarks: by
    people.
    """

    bench: str
    simulated: bool
    seed: int
    serials: tuple[FileName, ...]
    signs: dict[FileName, Literal[1, -1]]
    calibration: dict[str, FileInUse]
    config: BenchConfig
    objects: tuple[FileName, ...]
    remarks: Remarks = NO_REMARKS


@dataclass(frozen=True, kw_only=True)
class TrialManifest(BenchManifest):
    """A trial. skip: whether the estimator skips stages that a frame does not need.

    truth: the true angles were measured by the markers' edges. react: reaction to slip;
    false_alarms_per_hour, max_turn_deg: its settings, see `rig.lift.slip_watch.SlipSettings`. markers_only:
    of the external camera's pictures only the surroundings of the markers are stored.
    """

    kind: Literal["trial"]
    lifts_per_object: int
    estimator: str
    window: int
    skip: bool
    truth: Literal["edges"]
    react: ReactionKind = ReactionKind.NONE
    false_alarms_per_hour: Annotated[float, Field(gt=0, le=100_000)] = 10.0
    max_turn_deg: Annotated[float, Field(gt=0, le=180)] | None = None
    markers_only: bool = False

    @property
    def wanted(self) -> int:
        return len(self.objects) * self.lifts_per_object


@dataclass(frozen=True, kw_only=True)
class RecordManifest(BenchManifest):
    """A recording. images: number over all poses and fingertips. randomised: sensors drawn from the seed.

    by: whether the arm or a person's hand holds the object.
    """

    kind: Literal["record"]
    poses: int
    images: int
    randomised: bool = False
    by: Literal["arm", "hand"] = "arm"

    @property
    def wanted(self) -> int:
        return self.poses


@dataclass(frozen=True, kw_only=True)
class ReplayManifest(Manifest):
    """A replay of many sessions. estimator, window: None for those of each session."""

    kind: Literal["replay"]
    sessions: tuple[str, ...]
    estimator: str | None
    window: int | None


AnyManifest = TrialManifest | RecordManifest | ReplayManifest
Wanted = TypeVar("Wanted", bound=Manifest)


def begin_manifest(kind: str) -> Manifest:
    return Manifest(
        schema_version=SCHEMA_VERSION,
        tool_version=VERSION,
        kind=kind,
        status="running",
        started=now_text(),
        processor=processor(),
    )


def begun_on(
    bench: BenchConfig, kind: str, seed: int, objects: Iterable[str], remarks: Remarks = NO_REMARKS
) -> BenchManifest:
    """Return the fields of a new manifest for a session on a bench. objects: ids."""
    ids = tuple(objects)
    return BenchManifest(
        **vars(begin_manifest(kind)),
        bench=bench.name,
        simulated=bench.simulated,
        seed=seed,
        serials=tuple(sensor.serial for sensor in bench.sensors),
        signs={t.serial: t.sign for t in bench.tactile},
        calibration=dict(bench.calibrations.files),
        config=with_objects_of(bench.without_passwords(), ids),
        objects=ids,
        remarks=remarks,
    )


def now_text() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def is_session(folder: Path) -> bool:
    return (folder / MANIFEST).is_file()


def read_manifest(folder: Path) -> AnyManifest:
    """Read and check a session's manifest. Raises `SessionError`."""
    if not folder.is_dir():
        raise SessionError(no_such(folder, "session folder"))
    path = folder / MANIFEST
    text = read_whole(path)
    try:
        head = _HEAD.parse(text)
    except ValueError as error:
        raise SessionError(f"{path}: cannot be read ({error}); the session is damaged") from error
    if head.schema_version != SCHEMA_VERSION:
        when = f" at {head.started}" if head.started else ""
        raise SessionError(
            f"{path}: schema version {head.schema_version}, this version reads {SCHEMA_VERSION}; use the "
            f"version or commit that wrote it: version {head.tool_version or 'unknown'}{when}"
        )
    if head.kind not in RESULTS:
        raise SessionError(f"{path}: a {quote(head.kind)} session; this version reads {', '.join(RESULTS)}")
    try:
        manifest = _MANIFESTS.parse(text)
    except ValueError as error:
        raise SessionError(
            f"{path}: {error}; the session is damaged, or a newer version of the rig wrote it"
        ) from error
    if not isinstance(manifest, BenchManifest):
        return manifest
    stored = Calibrations(manifest.calibration, folder / CALIBRATIONS)
    return replace(manifest, config=manifest.config.model_copy(update={"calibrations": stored}))


def read_manifest_of(folder: Path, kind: type[Wanted] | tuple[type[Wanted], ...], why: str) -> Wanted:
    """Read the manifest of a session of certain kinds, see `require_kind`. Raises `SessionError`."""
    return require_kind(folder, read_manifest(folder), kind, why)


def require_kind(
    folder: Path, manifest: Manifest, kind: type[Wanted] | tuple[type[Wanted], ...], why: str
) -> Wanted:
    """Return the manifest if it is of a kind, such as `TrialManifest`.

    why: what is wrong with another kind, such as "only trials have lifts to replay". Raises `SessionError`.
    """
    if not isinstance(manifest, kind):
        raise SessionError(f"{folder}: is a '{manifest.kind}' session; {why}")
    return manifest


def first_difference(manifest: Manifest, wanted: Manifest) -> str | None:
    """Return the first difference between a session and the request, as "seed 0, not 1"; None without any.

    For the bench and its calibrations it names the single differing value, as "config.camera.focal_px". The
    feeder and the limits of a bench file may change: they change no result.
    """
    if type(manifest) is not type(wanted):
        return f"kind {manifest.kind}, not {wanted.kind}"
    manifest, wanted = _without_feeder_and_limits(manifest), _without_feeder_and_limits(wanted)
    keys = (field.name for field in fields(wanted) if field.name not in _OWN)
    key = next((key for key in keys if getattr(manifest, key) != getattr(wanted, key)), None)
    return (
        None
        if key is None
        else _difference(key, *(json_value(m).get(key, getattr(m, key)) for m in (manifest, wanted)))
    )


def _without_feeder_and_limits(manifest: Manifest) -> Manifest:
    if not isinstance(manifest, BenchManifest):
        return manifest
    config = manifest.config.model_copy(update={"limits": ()})
    if config.table is not None:
        config = config.model_copy(update={"table": config.table.model_copy(update={"feeder": None})})
    return replace(manifest, config=config)


def _difference(key: str, there: Any, asked: Any) -> str:
    if isinstance(there, dict) and isinstance(asked, dict):
        inner = next(k for k in (*there, *asked) if there.get(k) != asked.get(k))
        return _difference(f"{key}.{inner}", there.get(inner), asked.get(inner))
    if isinstance(there, list) and isinstance(asked, list) and len(there) == len(asked) > 0:
        place = next(i for i, (a, b) in enumerate(zip(there, asked, strict=True)) if a != b)
        if isinstance(there[place], dict):
            return _difference(f"{key}[{place}]", there[place], asked[place])
    return f"{key} {_value(there)}, not {_value(asked)}"


def _value(value: Any) -> str:
    if value in (None, [], {}):
        return "nothing"
    if isinstance(value, dict):
        return str(value.get("file", ", ".join(value)))
    return ", ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)


_OWN = {"schema_version", "tool_version", "status", "started", "completed", "processor", "remarks"}
"""Fields that describe the session's course and people's remarks, not what was requested."""


@dataclass(frozen=True)
class _Head:
    """The keys that identify version and kind of a manifest before the rest is read."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="ignore", strict=True)

    schema_version: int
    kind: str | None = None
    tool_version: str = ""
    started: str = ""


_HEAD: Codec[_Head] = Codec(_Head)
_MANIFESTS: Codec[AnyManifest] = Codec(
    Annotated[
        Annotated[TrialManifest, Tag("trial")]
        | Annotated[RecordManifest, Tag("record")]
        | Annotated[ReplayManifest, Tag("replay")],
        Discriminator(lambda values: str(values["kind"])),
    ]
)
