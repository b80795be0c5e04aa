"""The live view for Foxglove: a server on this computer to which the program Foxglove connects.

Topics: `/image/finger_b` and the like, `/image/camera`, its `/image/camera/markers`; `/angle/estimate`,
`/angle/markers`, deg; `/phase`; `/alarm`; `/arm/tcp` and `/tf`, m; `/gripper`, m; `/frames`; `/events`.
Times are the bench's own within a lift, moved to the time of day at its first message.
"""

import json
import time
from collections.abc import Mapping
from typing import Any

import foxglove
from foxglove import messages as schemas
from foxglove.channels import (
    CompressedImageChannel,
    FrameTransformChannel,
    ImageAnnotationsChannel,
    LogChannel,
    PoseInFrameChannel,
)
from foxglove.websocket import WebSocketServer

from drivers.clock import NS_PER_S
from rig.live.feed import Message
from rig.pages.palette import TRUTH

NUMBER, TEXT, TRUE_OR_FALSE = {"type": "number"}, {"type": "string"}, {"type": "boolean"}
TABLES: dict[str, dict[str, dict[str, Any]]] = {
    "/angle/estimate": dict.fromkeys(("angle_deg", "sigma_deg", "low_deg", "high_deg"), NUMBER),
    "/angle/markers": {"angle_deg": NUMBER},
    "/phase": {"phase": TEXT},
    "/alarm": {"slip": TRUE_OR_FALSE, "reaction": TEXT},
    "/gripper": {"opening_m": NUMBER, "moving": TRUE_OR_FALSE},
    "/frames": {"rates_hz": {"type": "object"}, "dropped": {"type": "object"}},
}
"""Fields of the topics without a schema of Foxglove's."""
RED, GREEN, BLUE = (value / 255 for value in bytes.fromhex(TRUTH.dark[1:]))
MARKER_COLOUR = schemas.Color(r=RED, g=GREEN, b=BLUE, a=1.0)


class FoxgloveScene:
    """Serves messages to Foxglove. If lifts run side by side, only those of one process are shown.

    names: of the fingertips by serial, as "finger_b". context: of the sinks. server: whether to serve.
    """

    def __init__(
        self, names: Mapping[str, str], context: foxglove.Context, server: WebSocketServer | None
    ) -> None:
        self._names, self._context, self._server = names, context, server
        self._images: dict[str, CompressedImageChannel] = {}
        self._tables = {
            topic: foxglove.Channel(
                topic,
                schema={"type": "object", "title": f"rig{topic}", "properties": fields},
                context=context,
            )
            for topic, fields in TABLES.items()
        }
        self._markers = ImageAnnotationsChannel("/image/camera/markers", context=context)
        self._pose = PoseInFrameChannel("/arm/tcp", context=context)
        self._transform = FrameTransformChannel("/tf", context=context)
        self._events = LogChannel("/events", context=context)
        self._sender: int | None = None
        self._lift: tuple[int, int] | None = None
        self._offset_ns: int | None = None
        self._latest_ns = 0
        self._slip = False

    def show(self, message: Message) -> None:
        """Show a message of the process that is followed: the first that sends any."""
        values = message.values
        self._sender = values["sender"] if self._sender is None else self._sender
        if values["sender"] != self._sender:
            return
        if (values["number"], values["attempt"]) != self._lift:
            self._lift, self._offset_ns, self._slip = (values["number"], values["attempt"]), None, False
        if "time_ns" not in values:
            mark = "SIMULATED " if values.get("simulated") else ""
            self._log(
                max(time.time_ns(), self._latest_ns), f"{mark}lift {values['number']}: {values['name']}"
            )
            return
        show = {
            "frame": self._frame, "arm": self._arm, "phase": self._phase, "figures": self._figures,
            "gripper": self._gripper, "reaction": self._reaction,
        }  # fmt: skip
        if message.kind in show:
            show[message.kind](self._dated(values["time_ns"]), values, message.picture)

    def close(self) -> None:
        """Stop serving."""
        if self._server is not None:
            self._server.stop()

    def _dated(self, time_ns: int) -> int:
        """Return the time of day, ns, of a time of the bench; lifts never overlap."""
        if self._offset_ns is None:
            self._offset_ns = max(time.time_ns(), self._latest_ns + NS_PER_S) - time_ns
        dated = time_ns + self._offset_ns
        self._latest_ns = max(self._latest_ns, dated)
        return dated

    def _frame(self, dated: int, values: dict[str, Any], picture: bytes) -> None:
        camera = values.get("source") == "camera"
        name = "camera" if camera else self._names.get(values["serial"], values["serial"])
        if name not in self._images:
            self._images[name] = CompressedImageChannel(f"/image/{name}", context=self._context)
        image = schemas.CompressedImage(timestamp=_stamp(dated), frame_id=name, data=picture, format="jpeg")
        self._images[name].log(image, log_time=dated)
        if camera:
            outlines = [
                schemas.PointsAnnotation(
                    type=schemas.PointsAnnotationType.LineLoop, outline_color=MARKER_COLOUR, thickness=2.0,
                    points=[schemas.Point2(x=x, y=y) for x, y in marker],
                )
                for marker in values["markers_px"] or ()
            ]  # fmt: skip
            found = schemas.ImageAnnotations(timestamp=_stamp(dated), points=outlines)
            self._markers.log(found, log_time=dated)

    def _arm(self, dated: int, values: dict[str, Any], _: bytes) -> None:
        x, y, z = values["position_m"]
        qx, qy, qz, qw = values["quaternion_xyzw"]
        position, turn = schemas.Vector3(x=x, y=y, z=z), schemas.Quaternion(x=qx, y=qy, z=qz, w=qw)
        pose = schemas.Pose(position=position, orientation=turn)
        stamp = _stamp(dated)
        self._pose.log(schemas.PoseInFrame(timestamp=stamp, frame_id="base", pose=pose), log_time=dated)
        transform = schemas.FrameTransform(
            timestamp=stamp, parent_frame_id="base", child_frame_id="tcp", translation=position, rotation=turn
        )
        self._transform.log(transform, log_time=dated)

    def _phase(self, dated: int, values: dict[str, Any], _: bytes) -> None:
        self._table("/phase", dated, {"phase": values["phase"]})
        self._log(dated, f"phase {values['phase']}")

    def _figures(self, dated: int, values: dict[str, Any], _: bytes) -> None:
        for time_ns, angle, sigma in values["estimate"]:
            fields = {"angle_deg": angle, "sigma_deg": sigma}
            if angle is not None and sigma is not None:
                fields |= {"low_deg": angle - sigma, "high_deg": angle + sigma}
            self._table("/angle/estimate", self._dated(time_ns), fields)
        for time_ns, angle in values["truth"]:
            self._table("/angle/markers", self._dated(time_ns), {"angle_deg": angle})
        self._table("/frames", dated, {"rates_hz": values["rates_hz"], "dropped": values["dropped"]})
        if values["slip"] and not self._slip:
            self._log(dated, "slip", warning=True)
        self._slip = values["slip"]
        self._table("/alarm", dated, {"slip": self._slip})

    def _gripper(self, dated: int, values: dict[str, Any], _: bytes) -> None:
        self._table("/gripper", dated, {"opening_m": values["opening_m"], "moving": values["moving"]})

    def _reaction(self, dated: int, values: dict[str, Any], _: bytes) -> None:
        self._table("/alarm", dated, {"slip": self._slip, "reaction": values["step"]})
        self._log(dated, f"reaction: {values['step']}", warning=True)

    def _table(self, topic: str, dated: int, fields: dict[str, Any]) -> None:
        """Log the fields that have a value."""
        known = {name: value for name, value in fields.items() if value is not None}
        if known:
            self._tables[topic].log(known, log_time=dated)

    def _log(self, dated: int, text: str, warning: bool = False) -> None:
        level = schemas.LogLevel.Warning if warning else schemas.LogLevel.Info
        log = schemas.Log(timestamp=_stamp(dated), level=level, message=text, name="rig")
        self._events.log(log, log_time=dated)


def _stamp(time_ns: int) -> schemas.Timestamp:
    return schemas.Timestamp(*divmod(time_ns, NS_PER_S))


def open_scene(arguments: list[str]) -> FoxgloveScene:
    """Serve at a host and port. arguments: host, port, names of the fingertips by serial as JSON."""
    host, port, names = arguments
    context = foxglove.Context()
    server = foxglove.start_server(name="slip rig", host=host, port=int(port), context=context)
    return FoxgloveScene(json.loads(names), context, server)
