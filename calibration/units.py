"""Name the unit of a length that is out of range in the unit that its table states."""

_LENGTHS_M = {"metres": 1.0, "cm": 0.01, "mm": 1e-3, "inches": 0.0254, "micrometres": 1e-6}


def length_guess(value_m: float, stated: str, low_m: float, high_m: float) -> str:
    """Return "; in inches?", with the units that put a length within low_m and high_m; "" if none does.

    value_m: the length in m if its unit is `stated` ("metres", "mm").
    """
    number = abs(value_m) / _LENGTHS_M[stated]
    fitting = [
        name for name, scale in _LENGTHS_M.items() if name != stated and low_m <= number * scale <= high_m
    ]
    return f"; in {' or '.join(fitting)}?" if fitting else ""
