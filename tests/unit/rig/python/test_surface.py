"""The public interface of `import rig`: names, signatures, and the time of the import."""

import inspect
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

import drivers.errors
import rig

ROOT = Path(__file__).parents[4]
SIGNATURES = {
    "Angles": "(time_s, angle_deg, sigma_deg=<factory>, states=(), contact_area_px=<factory>, source='', "
    "zero_ns=0)",
    "open_session": "(folder)",
    "estimate": "(frames, background=None, *, times_s=None, fps=60.0, estimator='slip', window=None, "
    "pixel_aspect=None, gel=None)",
    "estimator": "(name='slip', *, background, window=None, pixel_aspect=None, sign=1, gel=None)",
    "score": "(estimate, truth)",
    "solve_camera": "(board_m, image_px, size_px)",
    "solve_hand_eye": "(base_T_tcp, camera_T_target, setup='eye-to-hand')",
}
PARTS = {
    "Angles": "angle_deg at at_ns between contact_area_px known of select sigma_deg source states time_ns "
    "time_s to_pandas zero_ns",
    "ArmTrack": "base_T_tcp joints_rad time_s",
    "CameraSolution": "distortion held_out_rms_px matrix reasons rejected rms_px sigma size_px verdict",
    "GripperTrack": "current_a moving opening_m time_s",
    "HandEyeSolution": "matrix reasons rejected sigma_deg sigma_m target verdict",
    "Lift": "answered arm background error_deg estimate estimator frames gripper lift markers mean_error_deg "
    "name number object outcome phases_s pixel_aspect serials sign simulated tip to_pandas truth wrench",
    "MarkerTrack": "corners_px time_s",
    "Score": "answered frames max_deg mean_deg std_deg within_two_sigma",
    "SensorFrame": "image mask time_s",
    "Session": "bench complete estimator folder lifts problems simulated started to_pandas",
    "SlipSample": "angle_deg contact_area_px cost_s disagreement estimated fault jumped rate_deg_s settled "
    "shift_px shows_contact sigma_deg since_zero skipped slip stage_s state time_ns time_s unseen_deg "
    "without_angle",
    "StreamingEstimator": "check_background set_reference settled slips_s track update update_at",
    "WrenchTrack": "force_n time_s torque_nm",
}
ERRORS = (
    "CalibrationError", "DeviceError", "EstimatorError", "FormatError", "HiddenPackageError", "InputError",
    "OperatorStopError", "RecordingError", "RigError", "SessionError",
)  # fmt: skip


def test_errors_are_those_that_the_rig_raises() -> None:
    for name in set(ERRORS) - {"HiddenPackageError"}:
        assert getattr(rig, name) is getattr(drivers.errors, name)
    with pytest.raises(rig.InputError, match="unknown estimator 'slop'"):
        rig.estimator("slop", background=np.zeros((32, 24, 3), np.uint8))


def test_version_is_that_of_the_installed_package() -> None:
    assert rig.__version__ == version("visuotactile-slip-rig")


def test_version_is_known_without_an_installation() -> None:
    code = f"import sys; sys.path.insert(0, {str(ROOT)!r}); import rig; print(rig.__version__)"
    command = [sys.executable, "-I", "-S", "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == f"{rig.__version__}\n"


def test_public_names_are_fixed_and_documented() -> None:
    functions = {"estimate", "estimator", "open_session", "score", "solve_camera", "solve_hand_eye"}
    assert set(rig.__all__) == {*PARTS, *functions, *ERRORS}
    assert dir(rig) == sorted(rig.__all__)
    for name in rig.__all__:
        assert inspect.getdoc(getattr(rig, name)), name
    with pytest.raises(AttributeError, match="no attribute 'open_sesame'"):
        rig.open_sesame  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.parametrize("name", PARTS)
def test_public_class_has_its_attributes(name: str) -> None:
    kind = getattr(rig, name)
    here = {part for part in (*dir(kind), *getattr(kind, "__dataclass_fields__", ())) if part[0] != "_"}
    assert sorted(here | ({"lifts", "problems"} if name == "Session" else set())) == PARTS[name].split()


@pytest.mark.parametrize("name", SIGNATURES)
def test_public_function_has_its_signature(name: str) -> None:
    taken = inspect.signature(getattr(rig, name))
    bare = [p.replace(annotation=inspect.Parameter.empty) for p in taken.parameters.values()]
    assert str(inspect.Signature(bare)) == SIGNATURES[name]
    assert all(p.annotation is not inspect.Parameter.empty for p in taken.parameters.values())


def test_import_loads_no_heavy_modules() -> None:
    code = (
        "import sys, rig; heavy = {'numpy', 'cv2', 'scipy', 'pydantic', 'typer', 'rig.python'};"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
