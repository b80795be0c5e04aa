"""The live view for Foxglove: a server on this computer to which the program Foxglove connects.

Topics of all commands: `/image/tactile_1`, `/image/tactile_2`, in the order of the bench file or of the
command line, each with the contact's outline as `.../outline`; `/angle/estimate`, deg; `/alarm`; `/frames`;
`/events`. Of lifts also `/image/camera` and its `/image/camera/markers`; `/angle/markers`, deg; `/phase`;
`/arm/tcp` and `/tf`, m; `/gripper`, m. Of sensors on a desk also `/state`.
Times are those of the messages, moved to the time of day at the first message of a lift or of a desk.
"""

import json
import time
from collections.abc import Iterable, Mapping
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
from rig.live.feed import OBJECT, Message
from rig.pages.palette import ESTIMATE, TRUTH, Colour

NUMBER, TEXT, TRUE_OR_FALSE = {"type": "number"}, {"type": "string"}, {"type": "boolean"}
TABLES: dict[str, dict[str, dict[str, Any]]] = {
    "/angle/estimate": dict.fromkeys(("angle_deg", "sigma_deg", "low_deg", "high_deg"), NUMBER),
    "/angle/markers": {"angle_deg": NUMBER},
    "/phase": {"phase": TEXT},
    "/state": {"state": TEXT},
    "/alarm": {"slip": TRUE_OR_FALSE, "reaction": TEXT},
    "/gripper": {"opening_m": NUMBER, "moving": TRUE_OR_FALSE},
    "/frames": {"rates_hz": {"type": "object"}, "dropped": {"type": "object"}},
}
"""Fields of the topics for which Foxglove has no schema."""


class FoxgloveScene:
    """Serves messages to Foxglove. If lifts run in parallel, only those of one process are shown.

    names: of the tactile sensors by serial, as "finger_b", in the order of their topics. context: of the
    sinks. server: whether to serve.
    """

    def __init__(
        self, names: Mapping[str, str], context: foxglove.Context, server: WebSocketServer | None
    ) -> None:
        self._names, self._context, self._server = names, context, server
        self._topics = {serial: f"/image/tactile_{place}" for place, serial in enumerate(names, 1)}
        self._images: dict[str, CompressedImageChannel] = {}
        self._outlines: dict[str, ImageAnnotationsChannel] = {}
        self._tables = {
            topic: foxglove.Channel(
                topic,
                schema={"type": "object", "title": f"rig{topic}", "properties": fields},
                context=context,
            )
            for topic, fields in TABLES.items()
        }
        self._pose = PoseInFrameChannel("/arm/tcp", context=context)
        self._transform = FrameTransformChannel("/tf", context=context)
        self._events = LogChannel("/events", context=context)
        self._sender: int | None = None
        self._lift: tuple[int | None, int | None] | None = None
        self._offset_ns: int | None = None
        self._latest_ns = 0
        self._slip = False
        self._sensors: dict[str, dict[str, Any]] = {}

    def show(self, message: Message) -> None:
        """Show a message if it is from the first process that has sent one.

        Messages of lifts have their number and attempt; messages of sensors on a desk have none.
        """
        values = message.values
        self._sender = values["sender"] if self._sender is None else self._sender
        if values["sender"] != self._sender:
            return
        lift = (values.get("number"), values.get("attempt"))
        if lift != self._lift:
            self._lift, self._offset_ns, self._slip = lift, None, False
        if "time_ns" not in values:
            self._log(max(time.time_ns(), self._latest_ns), _title(values))
            return
        show = {
            "frame": self._frame, "arm": self._arm, "phase": self._phase, "figures": self._figures,
            "gripper": self._gripper, "reaction": self._reaction, "sensor": self._desk,
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
        if values.get("source") == "camera":
            self._image(dated, "/image/camera", "camera", picture)
            self._outline(dated, "/image/camera/markers", values["markers_px"] or (), TRUTH)
        else:
            self._tactile(dated, values["serial"], picture)

    def _desk(self, dated: int, values: dict[str, Any], picture: bytes) -> None:
        """Show a reading of a sensor on a desk, or of the object that two sensors touch."""
        name = values["sensor"]
        if picture:
            topic = self._tactile(dated, name, picture)
            outline = values["outline"]
            self._outline(dated, f"{topic}/outline", [outline] if outline else (), ESTIMATE)
            self._sensors[name] = values
        if name == OBJECT or len(self._names) == 1:
            self._angle(dated, values["angle_deg"], values["sigma_deg"])
            self._table("/state", dated, {"state": values["state"]})
            self._alarm(dated, values["slip"])
            rates_hz = {each: shown["fps"] for each, shown in self._sensors.items()}
            dropped = {each: shown["dropped"] for each, shown in self._sensors.items()}
            self._table("/frames", dated, {"rates_hz": rates_hz, "dropped": dropped})

    def _tactile(self, dated: int, serial: str, picture: bytes) -> str:
        """Show a frame of a tactile sensor; return its topic."""
        topic = self._topics.get(serial, f"/image/{serial}")
        self._image(dated, topic, self._names.get(serial, serial), picture)
        return topic

    def _image(self, dated: int, topic: str, name: str, picture: bytes) -> None:
        if topic not in self._images:
            self._images[topic] = CompressedImageChannel(topic, context=self._context)
        image = schemas.CompressedImage(timestamp=_stamp(dated), frame_id=name, data=picture, format="jpeg")
        self._images[topic].log(image, log_time=dated)

    def _outline(self, dated: int, topic: str, loops_px: Iterable[Any], colour: Colour) -> None:
        """Show closed lines over an image. loops_px: points of each line, x right and y down."""
        if topic not in self._outlines:
            self._outlines[topic] = ImageAnnotationsChannel(topic, context=self._context)
        red, green, blue = (value / 255 for value in bytes.fromhex(colour.dark[1:]))
        outlines = [
            schemas.PointsAnnotation(
                type=schemas.PointsAnnotationType.LineLoop, thickness=2.0,
                outline_color=schemas.Color(r=red, g=green, b=blue, a=1.0),
                points=[schemas.Point2(x=x, y=y) for x, y in loop],
            )
            for loop in loops_px
        ]  # fmt: skip
        found = schemas.ImageAnnotations(timestamp=_stamp(dated), points=outlines)
        self._outlines[topic].log(found, log_time=dated)

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
            self._angle(self._dated(time_ns), angle, sigma)
        for time_ns, angle in values["truth"]:
            self._table("/angle/markers", self._dated(time_ns), {"angle_deg": angle})
        self._table("/frames", dated, {"rates_hz": values["rates_hz"], "dropped": values["dropped"]})
        self._alarm(dated, values["slip"])

    def _angle(self, dated: int, angle: float | None, sigma: float | None) -> None:
        fields = {"angle_deg": angle, "sigma_deg": sigma}
        if angle is not None and sigma is not None:
            fields |= {"low_deg": angle - sigma, "high_deg": angle + sigma}
        self._table("/angle/estimate", dated, fields)

    def _alarm(self, dated: int, slip: bool) -> None:
        if slip and not self._slip:
            self._log(dated, "slip", warning=True)
        self._slip = slip
        self._table("/alarm", dated, {"slip": slip})

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


def _title(values: dict[str, Any]) -> str:
    """Return the text of a message without a time: a notice, or the beginning of a lift."""
    if "text" in values:
        return str(values["text"])
    return f"{'SIMULATED ' if values.get('simulated') else ''}lift {values['number']}: {values['name']}"


def _stamp(time_ns: int) -> schemas.Timestamp:
    return schemas.Timestamp(*divmod(time_ns, NS_PER_S))


def open_scene(arguments: list[str]) -> FoxgloveScene:
    """Serve at a host and port. arguments: host, port, names of the tactile sensors by serial as JSON."""
    host, port, names = arguments
    context = foxglove.Context()
    server = foxglove.start_server(name="slip rig", host=host, port=int(port), context=context)
    return FoxgloveScene(json.loads(names), context, server)
