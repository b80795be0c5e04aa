"""Contact masks as COCO or LabelMe, beside copies of the images."""

import json
from collections import Counter
from pathlib import PurePosixPath

from drivers.errors import counted
from rig.export.images import ContactImage, contact_images
from rig.export.result import Exported, ExportRequest, simulated_mark
from rig.labels.coco import LabelledImage, coco_document
from rig.labels.labelme import labelme_document
from rig.labels.polygons import mask_polygons

LABEL = "contact"


def export_coco(request: ExportRequest) -> Exported:
    """Write `images/` and `annotations.json`. Raises `SessionError` for a damaged session."""
    labelled, notes = [], Counter[str]()
    for image in contact_images(request):
        _keep(request, image, f"images/{image.name}")
        labelled.append(LabelledImage(image.name, image.size, LABEL, mask_polygons(image.mask)))
        notes[image.note] += 1
    said = _said(request, notes)
    document = coco_document(labelled, f"{request.session.name}; {'; '.join(said)}")
    (request.out / "annotations.json").write_text(json.dumps(document))
    annotated = sum(bool(image.polygons) for image in labelled)
    return Exported({"images": len(labelled), "annotations": annotated}, said)


def export_labelme(request: ExportRequest) -> Exported:
    """Write the images with LabelMe's file beside each. Raises `SessionError` for a damaged session."""
    notes = Counter[str]()
    for image in contact_images(request):
        path = PurePosixPath(image.name)
        _keep(request, image, image.name)
        document = labelme_document(path.name, image.size, mask_polygons(image.mask), LABEL, image.note)
        (request.out / path.with_suffix(".json")).write_text(json.dumps(document, indent=1))
        notes[image.note] += 1
    return Exported({"images": notes.total()}, _said(request, notes))


def _keep(request: ExportRequest, image: ContactImage, name: str) -> None:
    path = request.out / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(image.encoded)


def _said(request: ExportRequest, notes: "Counter[str]") -> tuple[str, ...]:
    mark = simulated_mark(request.manifest)
    return tuple(f"{mark}{counted(count, 'image')}, {note}" for note, count in sorted(notes.items()))
