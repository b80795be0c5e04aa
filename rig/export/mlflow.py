"""Log a trial as a run of MLflow: figures, settings, tags and report, on a tracking server or in a store."""

import json
import math
from dataclasses import asdict
from importlib import import_module
from typing import Any

from drivers.errors import InputError
from rig.export.result import Exported, ExportRequest, simulated_mark
from rig.results.summary import summarize_trial
from rig.results.table import TableHead, table_row
from rig.sessions.manifest import TrialManifest, require_kind

MLFLOW: Any = import_module("mlflow")
ENTITIES: Any = import_module("mlflow.entities")
LOGGED_FILES = ("report.html", "session.json", "lifts.csv")
"""Files of a session that are stored with the run, if they are there."""
LONGEST_PARAM = 6000
"""Number of characters of a parameter that all versions of MLflow accept."""


def export_mlflow(request: ExportRequest) -> Exported:
    """Log the run, and write `run.json` with its id to the folder of the export.

    Raises `SessionError` for a session of rig record, `InputError` without `request.uri` or if the server
    does not accept the run.
    """
    why = "a recording has no figures; --to mlflow is for trials"
    manifest = require_kind(request.session, request.manifest, TrialManifest, why)
    if request.uri is None:
        raise InputError("--to mlflow needs --mlflow URI, as http://localhost:5000 or sqlite:///runs.db")
    metrics = [*_figures(request), *_lifts(request, manifest)]
    try:
        run = _log(MLFLOW.MlflowClient(tracking_uri=request.uri), request, manifest, metrics)
    except (MLFLOW.MlflowException, OSError, ImportError) as error:
        said = " ".join(str(error).split())
        cure = (
            "; a database file needs the full package: pip install mlflow" if "sqlite:" in request.uri else ""
        )
        raise InputError(f"--mlflow {request.uri}: the run cannot be logged ({said}){cure}") from error
    (request.out / "run.json").write_text(json.dumps({"uri": request.uri, **run}, indent=1))
    note = f"{simulated_mark(manifest)}MLflow run {run['run_id']} of experiment '{run['experiment']}'"
    return Exported({"runs": 1, "metrics": len(metrics)}, (note,))


def _log(client: Any, request: ExportRequest, manifest: TrialManifest, metrics: list[Any]) -> dict[str, str]:
    """Log everything; return the name of the experiment and the id of the run."""
    name = f"rig trial, bench {manifest.bench}"
    known = client.get_experiment_by_name(name)
    experiment = client.create_experiment(name) if known is None else known.experiment_id
    run = client.create_run(experiment, run_name=manifest.remarks.name or request.session.name).info.run_id
    client.log_batch(run, params=_params(manifest), tags=_tags(request, manifest))
    for first in range(0, len(metrics), 1000):
        client.log_batch(run, metrics=metrics[first : first + 1000])
    for file in LOGGED_FILES:
        path = request.session / file
        if path.is_file():
            client.log_artifact(run, str(path))
    client.set_terminated(run)
    return {"experiment": name, "run_id": run}


def _params(manifest: TrialManifest) -> list[Any]:
    values = {
        key: getattr(manifest, key)
        for key in (
            "bench",
            "seed",
            "estimator",
            "window",
            "skip",
            "lifts_per_object",
            "false_alarms_per_hour",
        )
    }
    values |= {"react": manifest.react.value, "max_turn_deg": manifest.max_turn_deg}
    values |= {"objects": " ".join(manifest.objects), "serials": " ".join(manifest.serials)}
    return [
        ENTITIES.Param(key, str(value)[:LONGEST_PARAM]) for key, value in values.items() if value is not None
    ]


def _tags(request: ExportRequest, manifest: TrialManifest) -> list[Any]:
    remarks = manifest.remarks
    values = {
        "session": request.session.name,
        "started": manifest.started,
        "simulated": simulated_mark(manifest).strip() or "no",
        "rig_version": manifest.tool_version,
        "operator": remarks.operator,
        "mlflow.note.content": remarks.note,
        **{f"tag.{tag}": "yes" for tag in remarks.tags},
    }
    return [ENTITIES.RunTag(key, value) for key, value in values.items() if value]


def _figures(request: ExportRequest) -> list[Any]:
    """Return the figures of the trial as metrics, with the names of `rig trial --json`."""
    return _metrics(summarize_trial(request.lifts).as_json(), "", 0)


def _lifts(request: ExportRequest, manifest: TrialManifest) -> list[Any]:
    """Return the figures of each lift as metrics `lift.COLUMN`, columns as in lifts.csv, by lift number."""
    head = TableHead(
        request.session.name, manifest.started, manifest.bench, manifest.estimator, manifest.window
    )
    return [
        metric
        for lift in request.finished_lifts
        for metric in _metrics(asdict(table_row(head, lift)), "lift.", lift.number)
    ]


def _metrics(values: dict[str, Any], prefix: str, step: int) -> list[Any]:
    return [
        ENTITIES.Metric(prefix + key, float(value), 0, step)
        for key, value in values.items()
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    ]
