"""Training, resuming, exporting and importing networks; needs the extra `train`."""

import pickle
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

if any(find_spec(name) is None for name in ("torch", "segmentation_models_pytorch", "onnx", "onnxscript")):
    pytest.skip("the extra `train` is not installed", allow_module_level=True)

import torch

from drivers.errors import InputError
from rig.labels.datasets import FOLDS
from rig.tactile.contact.network import Recipe, load_network
from rig.training import networks
from rig.training.examples import simulated_examples
from rig.training.export import export_eight_bit, export_half, export_onnx, import_checkpoint
from rig.training.loop import LabelledFrame, Schedule, Training, arithmetic_of, augment, focal_loss
from rig.training.networks import ARCHITECTURES, build_network, find_architecture
from rig.training.run import TrainSettings, train_all

OURS, PSPNET = ARCHITECTURES["ours"], ARCHITECTURES["pspnet"]
# torch and its exporter warn about their own insides
pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(scope="module")
def examples():
    torch.set_num_threads(1)
    return simulated_examples(["1", "7"], 48, 0, (128, 160), family=True)


def trained(epochs: int, seed: int) -> Training:
    return Training(OURS, "resnet18", (96, 80), Schedule(epochs, 16, 4e-3, True), seed)


def test_training_lowers_the_loss(examples, tmp_path: Path) -> None:
    training = trained(6, 0)
    training.run(examples, examples, tmp_path / "state.pt")
    assert training.history[-1].loss < 0.8 * training.history[0].loss


def test_training_continued_after_a_stop_ends_as_one_that_was_not_stopped(examples, tmp_path: Path) -> None:
    whole, first, second = (trained(2, 3) for _ in range(3))
    whole.run(examples, examples, tmp_path / "whole.pt")

    def stop(epoch: object, _: float) -> None:
        if epoch is not None:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        first.run(examples, examples, tmp_path / "cut.pt", stop)
    second.load(tmp_path / "cut.pt")
    second.run(examples, examples, tmp_path / "cut.pt")
    assert [e.number for e in second.history] == [1, 2]
    for name, weight in whole.network.state_dict().items():
        torch.testing.assert_close(second.network.state_dict()[name], weight)


@pytest.mark.parametrize(
    ("capabilities", "expected"),
    [({"avx512_bf16": True}, torch.bfloat16), ({"bf16": True}, torch.bfloat16), ({}, torch.float32)],
)
def test_brain_floats_are_used_where_the_processor_multiplies_them(
    capabilities: dict[str, bool], expected: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: capabilities, raising=False)
    assert arithmetic_of(torch.device("cpu")) is expected


def test_the_focal_loss_is_the_cross_entropy_weighed_by_what_is_not_known() -> None:
    logits, labels = torch.tensor([2.0, -1.0]), torch.tensor([1.0, 1.0])
    share = 1.0 / (1.0 + np.exp(-np.array([2.0, -1.0])))
    expected = np.mean((1.0 - share) ** 2 * -np.log(share))
    assert float(focal_loss(logits, labels)) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("name", list(ARCHITECTURES))
def test_every_network_answers_a_logit_per_pixel_and_exports(name: str, tmp_path: Path) -> None:
    architecture = find_architecture(name)
    network = build_network(architecture).eval()
    recipe = Recipe(architecture.inputs, architecture.threshold)
    difference = export_onnx(network, architecture.inputs.channels, (64, 64), recipe, tmp_path / "n.onnx")
    assert difference <= 1e-4
    loaded = load_network(tmp_path / "n.onnx")
    assert loaded.recipe == recipe
    assert loaded.size == (64, 64)


def test_files_of_lower_precision_answer_as_the_full_one(examples, tmp_path: Path) -> None:
    network = build_network(OURS).eval()
    recipe = Recipe(OURS.inputs, 0.5, convex=True)
    full, half, eight = (tmp_path / f"{name}.onnx" for name in ("full", "half", "eight"))
    export_onnx(network, 6, (96, 80), recipe, full)
    export_half(full, half)
    export_eight_bit(full, examples, recipe, (96, 80), eight)
    planes = np.random.default_rng(0).random((6, 96, 80), np.float32) - 0.3
    expected = load_network(full).logits(planes)
    for path, most in ((half, 0.01), (eight, 0.15)):
        loaded = load_network(path)
        assert loaded.recipe == recipe
        assert path.stat().st_size < 0.6 * full.stat().st_size
        assert np.abs(loaded.logits(planes) - expected).max() < most * max(1.0, float(np.ptp(expected)))


@pytest.mark.parametrize("wrapper", ["", "module.", "model."])
def test_a_published_checkpoint_becomes_a_network_with_the_librarys_own_answer(
    wrapper: str, tmp_path: Path
) -> None:
    torch.manual_seed(5)
    network = build_network(PSPNET).eval()
    state = {wrapper + key: value for key, value in network.state_dict().items()}
    torch.save({"epoch": 30, "state_dict": state, "optimizer": {"lr": 1e-4}}, tmp_path / "published.pth")
    card = import_checkpoint(
        tmp_path / "published.pth", PSPNET, "resnet18", (320, 256), 0.7, tmp_path / "out" / "n.onnx"
    )
    planes = np.random.default_rng(1).random((3, 320, 256), np.float32)
    with torch.inference_mode():
        expected = network(torch.from_numpy(planes)[None])[0, 0].numpy()
    assert np.abs(load_network(tmp_path / "out" / "n.onnx").logits(planes) - expected).max() <= 1e-4
    assert card["threshold"] == 0.7
    assert (tmp_path / "out" / "n.json").exists()


def test_checkpoints_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    unetpp = build_network(ARCHITECTURES["unetplusplus"]).state_dict()
    torch.save({"state_dict": unetpp}, tmp_path / "unet.pth")
    torch.save([1, 2], tmp_path / "list.pth")
    torch.save({"state_dict": {}}, tmp_path / "empty.pth")
    (tmp_path / "cut.pth").write_bytes((tmp_path / "unet.pth").read_bytes()[:1000])
    wrong = {"unet": "--arch", "list": "list", "empty": "no weights", "cut": "complete", "none": "no such"}
    for name, said in wrong.items():
        with pytest.raises(InputError, match=said):
            networks.load_weights(build_network(PSPNET), tmp_path / f"{name}.pth")


def test_an_encoder_takes_its_own_weights_and_no_others(tmp_path: Path) -> None:
    made, wanted = build_network(PSPNET).encoder, build_network(PSPNET).encoder
    own = made.state_dict()
    torch.save({**own, "classifier.weight": torch.zeros(3)}, tmp_path / "own.pth")
    networks.fill_encoder(wanted, tmp_path / "own.pth")
    assert all(torch.equal(value, own[key]) for key, value in wanted.state_dict().items())
    torch.save({"features.0.weight": torch.zeros(3)}, tmp_path / "other.pth")
    torch.save({key: value[:1] for key, value in own.items() if value.dim()}, tmp_path / "narrow.pth")
    for name, said in (("other.pth", "lacks"), ("narrow.pth", "does not fit")):
        with pytest.raises(InputError, match=said):
            networks.fill_encoder(wanted, tmp_path / name)


class Malicious:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return print, ("run",)


def test_code_in_a_checkpoint_is_never_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "evil.pth").write_bytes(pickle.dumps({"state_dict": Malicious()}))
    with pytest.raises(InputError):
        networks.read_state(tmp_path / "evil.pth")
    assert "run" not in capsys.readouterr().out


def test_augmentation_keeps_colours_in_order_and_mirrors_nothing() -> None:
    frame = np.full((80, 64, 3), (240, 60, 12), np.uint8)
    label = np.zeros((80, 64), np.uint8)
    label[10:30, 8:24] = 255
    for seed in range(20):
        sample = augment(LabelledFrame(frame, frame // 2, label), frame, True, np.random.default_rng(seed))
        red, green, blue = sample.frame.reshape(-1, 3).mean(axis=0)
        assert red > green > blue
        rows, columns = np.nonzero(sample.label > 127)
        assert rows.mean() < 36
        assert columns.mean() < 28


@pytest.mark.heavy
def test_a_run_writes_networks_and_cards_and_is_not_done_twice(tmp_path: Path) -> None:
    settings = TrainSettings("simulated", (OURS,), (FOLDS["D_s3"],), "resnet18", 48, 1, False, 0, threads=1)
    cards = train_all(tmp_path / "run", settings, False, lambda text, share: None)
    folder = tmp_path / "run" / "ours_D_s3"
    names = {"model.onnx", "model.half.onnx", "model.int8.onnx"}
    assert {path.name for path in folder.glob("*.onnx")} == names
    assert cards[0]["images"]["test"] == 24
    assert cards[0]["training"]["cpu_s"] > 0.0
    assert cards[0]["files"]["fp32"]["dice"] == cards[0]["test"]["dice"]
    assert cards[0]["as_used"]["dice"] > cards[0]["test"]["dice"], "one epoch: the network finds little alone"
    stamp = (folder / "model.onnx").stat().st_mtime_ns
    assert train_all(tmp_path / "run", settings, True, lambda text, share: None) == cards
    assert (folder / "model.onnx").stat().st_mtime_ns == stamp
    with pytest.raises(InputError, match="--resume"):
        train_all(tmp_path / "run", settings, False, lambda text, share: None)
    with pytest.raises(InputError, match="seed"):
        train_all(tmp_path / "run", replace(settings, seed=1), True, lambda text, share: None)
