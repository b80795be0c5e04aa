"""The live view for Foxglove: its messages, its server, and its layout."""

import asyncio
import json
import socket
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from drivers.clock import NS_PER_S
from drivers.errors import InputError
from rig.live.feed import LiveFeed, Message, Sender
from rig.live.session import FOXGLOVE_LAYOUT, FoxgloveServer, live_session
from support.foxglove_client import first_message
from support.waiting import LIMIT_S

NAMES = {"D1": "finger_b", "D2": "finger_c"}
LIFT = {"number": 1, "attempt": 0, "name": "wrench", "sender": 7, "simulated": True}
FIGURES = {
    "time_ns": 6, "estimate": [(4, -3.0, 0.2), (5, None, None)], "truth": [(5, -3.1)], "slip": True,
    "rates_hz": {"D1": 60.0}, "dropped": {"D1": 0},
}  # fmt: skip
CORNERS = [[[1.0, 1.0], [2.0, 1.0], [2.0, 2.0], [1.0, 2.0]]]
MESSAGES = [
    ("lift", {}, b""),
    ("phase", {"phase": "B", "time_ns": 3}, b""),
    ("frame", {"serial": "D1", "time_ns": 3}, b"jpeg"),
    ("frame", {"serial": "C1", "time_ns": 4, "source": "camera", "markers_px": CORNERS}, b"jpeg"),
    ("arm", {"time_ns": 4, "position_m": [0.1, 0.2, 0.3], "quaternion_xyzw": [1.0, 0.0, 0.0, 0.0]}, b""),
    ("gripper", {"time_ns": 5, "opening_m": 0.04, "moving": False}, b""),
    ("figures", FIGURES, b""),
    ("reaction", {"time_ns": 7, "step": "stop"}, b""),
]


def recorded(
    path: Path, messages: list[Message], names: dict[str, str] = NAMES
) -> dict[str, list[tuple[int, Any]]]:
    """Show messages to a scene that writes a file; return what the file has, by topic, with times."""
    foxglove = pytest.importorskip("foxglove", reason="foxglove-sdk is not installed: extra 'foxglove'")
    from rig.live.foxglove import FoxgloveScene

    context = foxglove.Context()
    with foxglove.open_mcap(str(path), context=context):
        scene = FoxgloveScene(names, context, None)
        for message in messages:
            scene.show(message)
        scene.close()
    found: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            decode = json.loads
            if channel.message_encoding == "protobuf":
                decode = DecoderFactory().decoder_for("protobuf", schema)
            assert decode is not None
            found[channel.topic].append((message.log_time, decode(message.data)))
    return found


def test_lift_is_published_with_all_topics(tmp_path: Path) -> None:
    found = recorded(tmp_path / "f.mcap", [Message(k, {**LIFT, **v}, p) for k, v, p in MESSAGES])
    last = {topic: messages[-1][1] for topic, messages in found.items()}
    image = last["/image/tactile_1"]
    assert (image.data, image.format, image.frame_id) == (b"jpeg", "jpeg", "finger_b")
    assert [point.x for point in last["/image/camera/markers"].points[0].points] == [1.0, 2.0, 2.0, 1.0]
    assert last["/angle/estimate"] == {"angle_deg": -3.0, "sigma_deg": 0.2, "low_deg": -3.2, "high_deg": -2.8}
    assert len(found["/angle/estimate"]) == 1
    assert last["/angle/markers"] == {"angle_deg": -3.1}
    assert last["/phase"] == {"phase": "B"}
    assert last["/arm/tcp"].pose.position.z == 0.3
    assert (last["/tf"].parent_frame_id, last["/tf"].child_frame_id) == ("base", "tcp")
    assert last["/gripper"] == {"opening_m": 0.04, "moving": False}
    assert last["/alarm"] == {"slip": True, "reaction": "stop"}
    events = [message.message for _, message in found["/events"]]
    assert events == ["SIMULATED lift 1: wrench", "phase B", "slip", "reaction: stop"]
    times = {topic: messages[-1][0] for topic, messages in found.items()}
    assert times["/gripper"] - times["/image/tactile_1"] == 2
    assert abs(times["/phase"] - time.time_ns()) < 60 * NS_PER_S


def reading(name: str, angle: float | None, **more: object) -> dict[str, object]:
    return {
        "sender": 7, "sensor": name, "time_ns": 5, "t_s": 5e-9, "state": "tracking", "angle_deg": angle,
        "sigma_deg": 0.5, "slip": True, "fps": 60.0, "dropped": 2, **more,
    }  # fmt: skip


def test_sensors_on_a_desk_are_published_on_the_topics_of_a_lift(tmp_path: Path) -> None:
    outline = [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]
    messages = [
        Message("notice", {"sender": 7, "text": "taking the background"}),
        Message("sensor", reading("D2", 9.0, outline=[]), b"second"),
        Message("sensor", reading("D1", 8.0, outline=outline), b"first"),
        Message("sensor", reading("object", 7.0)),
    ]
    found = recorded(tmp_path / "f.mcap", messages)
    last = {topic: shown[-1][1] for topic, shown in found.items()}
    assert (last["/image/tactile_1"].data, last["/image/tactile_2"].data) == (b"first", b"second")
    assert [point.y for point in last["/image/tactile_1/outline"].points[0].points] == [2.0, 4.0, 6.0]
    assert len(last["/image/tactile_2/outline"].points) == 0
    assert [shown["angle_deg"] for _, shown in found["/angle/estimate"]] == [7.0]
    assert (last["/alarm"], last["/state"]) == ({"slip": True}, {"state": "tracking"})
    assert last["/frames"] == {"rates_hz": {"D1": 60.0, "D2": 60.0}, "dropped": {"D1": 2, "D2": 2}}
    assert [shown.message for _, shown in found["/events"]] == ["taking the background", "slip"]


def test_single_sensor_on_a_desk_gives_the_angle(tmp_path: Path) -> None:
    found = recorded(
        tmp_path / "f.mcap", [Message("sensor", reading("D", -4.0, outline=[]), b"jpeg")], {"D": "D"}
    )
    assert [shown["low_deg"] for _, shown in found["/angle/estimate"]] == [-4.5]


def test_lifts_follow_one_another_and_other_processes_are_left_out(tmp_path: Path) -> None:
    lifts = [
        Message("phase", {**LIFT, "number": number, "sender": sender, "phase": "B", "time_ns": time_ns})
        for number, sender, time_ns in ((1, 7, 0), (1, 7, 900 * NS_PER_S), (9, 8, 0), (2, 7, 0))
    ]
    times = [at for at, _ in recorded(tmp_path / "f.mcap", lifts)["/phase"]]
    assert len(times) == 3
    assert times == sorted(times)


def test_layout_shows_topics_that_are_published() -> None:
    foxglove_view = pytest.importorskip("rig.live.foxglove", reason="foxglove-sdk is not installed")
    layout = json.loads(FOXGLOVE_LAYOUT.read_text())
    text = json.dumps(layout)
    for topic, fields in foxglove_view.TABLES.items():
        for field in fields:
            assert (
                f"{topic}.{field}" in text
                or topic == "/frames"
                or field in ("sigma_deg", "moving", "reaction")
            )
    for image, lines in (("tactile_1", "outline"), ("tactile_2", "outline"), ("camera", "markers")):
        assert f'"/image/{image}"' in text
        assert f'"/image/{image}/{lines}"' in text
    assert '"/arm/tcp"' in text
    panels = json.dumps(layout["layout"])
    assert all(f'"{panel}"' in panels for panel in layout["configById"])


def test_connected_client_gets_the_messages() -> None:
    pytest.importorskip("foxglove", reason="foxglove-sdk is not installed: extra 'foxglove'")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]

    async def send() -> None:
        await asyncio.sleep(0.3)
        sender.send("figures", {**LIFT, **FIGURES})

    with live_session(False, None, foxglove=FoxgloveServer("127.0.0.1", port, NAMES)) as (feed, _):
        sender = Sender(LiveFeed(tuple(each for each in feed.listeners if each.pictures)))
        asked = first_message(f"ws://127.0.0.1:{port}/", "/angle/estimate", send)
        assert asyncio.run(asyncio.wait_for(asked, LIMIT_S))["angle_deg"] == -3.0
        sender.close()
        with pytest.raises(InputError, match=rf"--foxglove-at 127.0.0.1:{port}: nothing can be served there"):
            FoxgloveServer("127.0.0.1", port, NAMES).check()


def test_missing_foxglove_is_named_with_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.config.extras.find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"needs foxglove-sdk.*\[foxglove\]"):
        FoxgloveServer("127.0.0.1", 8765, NAMES).check()
