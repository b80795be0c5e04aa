"""The numbers a training calculates with: brain floats where the processor multiplies them itself."""

import torch

_BRAIN_FLOAT_UNITS = ("amx_bf16", "avx512_bf16", "bf16")
"""Of x86 (tiles, vectors) and of ARM, as torch names what a processor is capable of."""


def arithmetic_of(device: torch.device) -> torch.dtype:
    """Return bfloat16 for a device that multiplies it, else float32.

    Layers then calculate with it (mixed precision, Micikevicius et al. 2018); weights, loss and
    optimizer stay float32, and so does what is exported. It takes half of the time or less, and more
    where it would be emulated.
    """
    if device.type == "cuda":
        able = torch.cuda.is_bf16_supported(including_emulation=False)
    else:
        # older versions of torch do not tell
        capabilities = getattr(torch.cpu, "get_capabilities", dict)()
        able = any(capabilities.get(unit, False) for unit in _BRAIN_FLOAT_UNITS)
    return torch.bfloat16 if able else torch.float32
