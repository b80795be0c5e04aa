"""Run Python as on an older processor: its libraries choose the code that they have for one without AVX.

    python .ci/other_processor.py -m pytest

Only features that this computer has are disabled: NumPy and OpenCV warn of all others.
"""

import os
import sys

import cv2
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

opencv = (name for name in cv2.getCPUFeaturesLine().split() if name.startswith("*AVX"))
os.environ |= {
    "NPY_DISABLE_CPU_FEATURES": " ".join(name for name in __cpu_dispatch__ if __cpu_features__[name]),
    "OPENCV_CPU_DISABLE": ",".join(name[1:] for name in opencv if not name.endswith("?")),
    "OPENBLAS_CORETYPE": "Nehalem",
    "NUMBA_CPU_NAME": "generic",
}
os.execv(sys.executable, [sys.executable, *sys.argv[1:]])  # noqa: S606
