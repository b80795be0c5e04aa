"""What the simulated controller publishes besides motion: inputs and outputs, and a healthy arm's figures."""

from fakes.wire.ur.variables import OutputBank, Value

_DIGITAL = (("standard", 0), ("configurable", 8), ("tool", 16))
JOINT_RUNNING = 253


def constants(bank: OutputBank) -> None:
    """Publish what does not change: voltages, temperatures and the like, of a warm arm at rest."""
    for name, value in {
        "speed_scaling": 1.0,
        "target_speed_fraction": 1.0,
        "actual_execution_time": 0.0005,
        "actual_main_voltage": 48.0,
        "actual_robot_voltage": 48.0,
        "actual_robot_current": 0.8,
        "actual_joint_voltage": (48.0,) * 6,
        "joint_temperatures": (29.0, 31.0, 31.0, 34.0, 35.0, 35.0),
        "joint_mode": (JOINT_RUNNING,) * 6,
        "actual_tool_accelerometer": (0.0, 0.0, -9.81),
        "tool_temperature": 35.0,
    }.items():
        bank.set(name, value)


class IoBoard:
    """Digital and analog outputs and the speed slider, as clients set them."""

    def __init__(self, bank: OutputBank) -> None:
        self._bank = bank
        self._digital = 0
        self.speed_scale = 1.0

    def apply(self, values: dict[str, Value]) -> None:
        """Take the inputs of a client's data package; masks say which of them count."""
        for name, first in _DIGITAL:
            if mask := int(values.get(f"{name}_digital_output_mask", 0)):  # type: ignore[arg-type]
                self.set_digital(mask << first, int(values[f"{name}_digital_output"]) << first)  # type: ignore[arg-type]
        if values.get("speed_slider_mask"):
            self._slide(float(values["speed_slider_fraction"]))  # type: ignore[arg-type]
        mask = int(values.get("standard_analog_output_mask", 0))  # type: ignore[arg-type]
        for i in (0, 1):
            if mask >> i & 1:
                self._bank.set(f"standard_analog_output{i}", values[f"standard_analog_output_{i}"])

    def set_digital(self, mask: int, levels: int) -> None:
        """Set the masked digital outputs: standard 0 to 7, configurable 8 to 15, tool 16 and 17."""
        self._digital = self._digital & ~mask | levels & mask
        self._bank.set("actual_digital_output_bits", self._digital)

    def _slide(self, fraction: float) -> None:
        self.speed_scale = max(0.0, min(1.0, fraction))
        self._bank.set("target_speed_fraction", self.speed_scale)
