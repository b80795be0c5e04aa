"""A target's sheet as PDF, in true size."""

from io import BytesIO

from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from calibration.targets.sheets import TEXT_MM, target_sheet

_MM_PER_INCH = 25.4
_POINTS_PER_INCH = 72.0


def sheet_pdf(spec: str) -> bytes:
    """The sheet of a target. Raises `InputError` for a target that is not understood."""
    sheet = target_sheet(spec)
    wide, high = sheet.size_mm
    figure = Figure(figsize=(wide / _MM_PER_INCH, high / _MM_PER_INCH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, wide), ylim=(high, 0.0))
    axes.axis("off")
    corners = [[(x, y), (x + w, y), (x + w, y + h), (x, y + h)] for x, y, w, h in sheet.ink]
    axes.add_collection(PolyCollection(corners, facecolors="black", linewidths=0.0))
    size = TEXT_MM / _MM_PER_INCH * _POINTS_PER_INCH
    axes.text(*sheet.text_mm, sheet.text, fontsize=size, family="sans-serif", va="baseline")
    stream = BytesIO()
    # without a date, so that equal targets give equal files
    figure.savefig(stream, format="pdf", metadata={"Title": spec, "CreationDate": None})
    return stream.getvalue()
