"""The process of the viewer rerun, `python -m rig.live.viewer ADDRESS`, and the scene that it shows.

It prints "ready" when it listens, and ends when its standard input ends, also if the process that started it
is killed.
"""

import os
import sys
import threading
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from drivers.children import leave_signals_to_parent
from drivers.clock import NS_PER_S
from rig.live.feed import Inbox, Message
from rig.pages.palette import ESTIMATE, TRUTH

APPLICATION = "slip_rig"
TIMELINE = "bench_time"
MEMORY_LIMIT = "1GB"
"""Memory limit of the viewer; beyond it the oldest data are dropped."""
BETWEEN_LIFTS_S = 1.0
EVERY_S = 0.05
GIVE_WAY = 10
"""Niceness of the viewer relative to the lifts (nice(2))."""
# The viewer is dark; hex as a list of red, green, blue.
ESTIMATE_RGB, TRUTH_RGB = (list(bytes.fromhex(colour.dark[1:])) for colour in (ESTIMATE, TRUTH))


class RerunScene:
    """Opens the rerun viewer and shows messages in it. Only this module imports rerun.

    If lifts run in parallel in several processes, only those of one process are shown.
    """

    def __init__(self) -> None:
        self._stream = rr.RecordingStream(APPLICATION)
        self._stream.spawn(memory_limit=MEMORY_LIMIT, default_blueprint=layout([]))
        for name, colour in (("estimate", ESTIMATE_RGB), ("markers", TRUTH_RGB)):
            self._stream.log(
                f"angle/{name}", rr.SeriesLines(colors=[colour], names=[f"{name}, deg"]), static=True
            )
        self._sender: int | None = None
        self._lift: tuple[int, int] | None = None
        self._serials: list[str] = []
        self._began_ns: int | None = None
        self._offset_s = 0.0
        self._latest_s = 0.0
        self._mark = ""

    def show(self, message: Message) -> None:
        """Show a message if it is from the first process that has sent one."""
        values = message.values
        self._sender = values["sender"] if self._sender is None else self._sender
        if values["sender"] != self._sender:
            return
        if (values["number"], values["attempt"]) != self._lift:
            self._mark = "SIMULATED " if values.get("simulated") else ""
            self._begin((values["number"], values["attempt"]), values["name"])
        show = {"frame": self._frame, "arm": self._arm, "phase": self._phase, "figures": self._figures}
        if message.kind in show:
            show[message.kind](values, message.picture)

    def close(self) -> None:
        self._stream.flush()
        self._stream.disconnect()

    def _begin(self, lift: tuple[int, int], name: str) -> None:
        self._lift, self._began_ns = lift, None
        self._offset_s = self._latest_s + BETWEEN_LIFTS_S if self._latest_s else 0.0
        self._stream.set_time(TIMELINE, duration=self._offset_s)
        self._stream.log("events", rr.TextLog(f"{self._mark}lift {lift[0]}: {name}"))

    def _at(self, time_ns: int) -> None:
        """Set the time on the timeline, on which the lifts follow one another."""
        self._began_ns = time_ns if self._began_ns is None else self._began_ns
        now_s = self._offset_s + (time_ns - self._began_ns) / NS_PER_S
        self._latest_s = max(self._latest_s, now_s)
        self._stream.set_time(TIMELINE, duration=now_s)

    def _frame(self, values: dict[str, Any], picture: bytes) -> None:
        self._at(values["time_ns"])
        image = rr.EncodedImage(contents=picture, media_type="image/jpeg")
        if values.get("source") != "camera":
            if values["serial"] not in self._serials:
                self._serials = sorted([*self._serials, values["serial"]])
                self._stream.send_blueprint(layout(self._serials, self._mark))
            self._stream.log(f"tactile/{values['serial']}", image)
            return
        self._stream.log("camera", image)
        corners = values["markers_px"]
        if corners is None:
            self._stream.log("camera/markers", rr.Clear(recursive=False))
        else:
            outlines = [[*marker, marker[0]] for marker in corners]
            self._stream.log("camera/markers", rr.LineStrips2D(outlines, colors=[TRUTH_RGB], radii=1.5))

    def _arm(self, values: dict[str, Any], _: bytes) -> None:
        self._at(values["time_ns"])
        pose = rr.Transform3D(
            translation=values["position_m"], quaternion=rr.Quaternion(xyzw=values["quaternion_xyzw"])
        )
        self._stream.log("arm/tcp", pose, rr.TransformAxes3D(axis_length=0.1))
        self._stream.log("arm/base", rr.TransformAxes3D(axis_length=0.2), static=True)

    def _phase(self, values: dict[str, Any], _: bytes) -> None:
        self._at(values["time_ns"])
        self._stream.log("events", rr.TextLog(f"phase {values['phase']}"))

    def _figures(self, values: dict[str, Any], _: bytes) -> None:
        for name, points in (("estimate", values["estimate"]), ("markers", values["truth"])):
            for time_ns, angle_deg, *_sigma in points:
                if angle_deg is not None:
                    self._at(time_ns)
                    self._stream.log(f"angle/{name}", rr.Scalars(angle_deg))


def layout(serials: list[str], mark: str = "") -> rrb.Blueprint:
    """Return the layout: images above, angles below, arm and events beside. mark: prefix of view names."""
    fingertips = [rrb.Spatial2DView(origin=f"tactile/{serial}", name=f"{mark}{serial}") for serial in serials]
    pictures = rrb.Horizontal(
        rrb.Spatial2DView(origin="camera", name=f"{mark}camera and markers"), *fingertips
    )
    angles = rrb.TimeSeriesView(origin="angle", name=f"{mark}angle, deg")
    arm = rrb.Spatial3DView(origin="arm", name=f"{mark}arm")
    events = rrb.TextLogView(origin="events", name=f"{mark}events")
    sides = rrb.Horizontal(rrb.Vertical(pictures, angles), rrb.Vertical(arm, events), column_shares=[3, 1])
    return rrb.Blueprint(sides, collapse_panels=True)


def main(address: str) -> None:
    """Show the messages that are sent to an address until the standard input ends."""
    # Ctrl-C is for the trial only; messages that the trial sends after it are still shown.
    leave_signals_to_parent()
    os.nice(GIVE_WAY)
    scene = RerunScene()
    inbox = Inbox(address)
    input_ended = threading.Thread(target=sys.stdin.read, daemon=True)
    input_ended.start()
    print("ready", flush=True)
    over = False
    while not over:
        input_ended.join(EVERY_S)
        over = not input_ended.is_alive()
        for message in inbox.take():
            scene.show(message)
    inbox.close()
    scene.close()


if __name__ == "__main__":
    main(sys.argv[1])
