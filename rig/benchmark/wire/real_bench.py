"""A bench behind wires that counts as real: nobody says of it that it is simulated."""

from rig.config import BenchConfig

TABLE_M = 0.02


def as_real(bench: BenchConfig) -> BenchConfig:
    """Return a bench without [fakes], with the height of the table that a real one has to say."""
    table = bench.table.model_copy(update={"top_m": TABLE_M})
    return bench.model_copy(update={"fakes": None, "table": table})
