"""Lets torchvision be imported beside a torch it was not built for.

segmentation-models-pytorch needs timm, which imports torchvision. A torchvision built for CUDA does not
import beside a CPU build of torch ("operator torchvision::nms does not exist"), although only its
compiled detection operators are missing, which segmentation never calls. Declaring their schemas is
enough; where the builds match, nothing is done.
"""

import importlib.util

import torch

# torchvision/csrc/ops/nms.cpp and quantized/cpu/qnms_kernel.cpp: what its import registers against
_SCHEMAS = {
    "nms": "nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor",
    "qnms": "qnms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor",
}
_kept: list[torch.library.Library] = []


def declare_missing_operators() -> None:
    """Import torchvision; where that fails for want of operators, declare them and import again."""
    if _kept or importlib.util.find_spec("torchvision") is None:
        return
    try:
        import torchvision  # noqa: F401
    except RuntimeError as error:
        if "torchvision::" not in str(error):
            raise
        library = torch.library.Library("torchvision", "FRAGMENT")
        for schema in _SCHEMAS.values():
            library.define(schema)
        # a library's declarations go when it is collected
        _kept.append(library)
