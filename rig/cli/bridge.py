"""`rig bridge`: publish live angles for other robot software."""

from contextlib import ExitStack
from dataclasses import dataclass

from rig.cli.common import mark, say
from rig.cli.helping import Commands
from rig.cli.live import (
    LiveAngleOptions,
    LiveSourceOptions,
    desk_of,
    is_simulated,
    run_desk,
    stopped_by_person,
)
from rig.declared import option

bridge = Commands(
    no_args_is_help=True, help="Publish live angles, alarms and images for other robot software."
)


@dataclass(frozen=True, slots=True)
class BridgeOptions:
    # 232: highest domain whose port numbers fit into 16 bits (RTPS 2.5, section 9.6.2)
    domain: int = option(
        0,
        "ROS domain of the nodes. Default: the environment variable ROS_DOMAIN_ID, else 0.",
        min=0,
        max=232,
        envvar="ROS_DOMAIN_ID",
    )
    seconds: float | None = option(None, "End after this time in s. Default: run until Ctrl-C.", min=0.0)


@bridge.command("ros2")
def ros2(source: LiveSourceOptions, how: LiveAngleOptions, to: BridgeOptions) -> None:
    """Publish images, angle and slip alarm of one or two sensors for ROS 2 nodes.

    ROS need not be installed on this computer. Nothing moves. Ctrl-C ends the command.

    The topics of a sensor are /NAME/image_raw/compressed (CompressedImage), /angle/NAME (JointState: angle,
    angle_sigma, angle_rate in rad and rad/s; NaN if unknown) and /slip/NAME (Bool). Two sensors also publish
    /angle/object and /slip/object. Time stamps are capture times. The angle is that of rig live.

    The messages reach all computers on the network interface that Cyclone DDS selects. Set its environment
    variable CYCLONEDDS_URI to select another interface.

    Examples:
      rig bridge ros2 fake
      rig bridge ros2 D20641 D20642 --domain 7
      rig bridge ros2 http://127.0.0.1:8080/stream.mjpg --background empty.png
    """
    from rig.config.extras import require_extra

    for package in ("cyclonedds", "rosbags"):
        require_extra(package, "ros2", "the bridge needs")
    with stopped_by_person() as stopped, ExitStack() as stack:
        from drivers.clock import SystemClock
        from drivers.realtime import compute_in_one_thread
        from rig.live.ros2_bridge import Ros2Bridge

        compute_in_one_thread()
        desk = stack.enter_context(desk_of(source, how, stack))
        publisher = Ros2Bridge(to.domain, SystemClock())
        topics = ", ".join(publisher.topics([*desk.sensors]))
        marked = mark(is_simulated(source.sources))
        say(f"{marked}publishing in domain {to.domain}: {topics}; press Ctrl-C to end")
        run_desk(desk, publisher.publish, to.seconds, stopped)
    say(f"ended: {publisher.published} messages published")
