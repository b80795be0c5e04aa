"""`rig benchmark faults`: each device fails in mid-lift over the wire protocols; the rig has to recover."""

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.errors import InputError
from rig.benchmark.harness import Report, Run, Study, option, table_of
from rig.benchmark.measured import Measured, at_most
from rig.benchmark.wire.fault_cases import CASES
from rig.benchmark.wire.fault_lifts import FaultRow, run_faults
from rig.config import load_bench


@dataclass(frozen=True, slots=True)
class FaultsOptions:
    """Options of `rig benchmark faults`."""

    cases: list[str] | None = option(None, "Only cases whose name contains this; repeat for more.", "--case")
    bench: str = option("wire", "wire, or the path of a bench file whose \\[fakes] are started for it.")


def measure(options: FaultsOptions, run: Run) -> Report:
    """Let each device fail during a lift over the wire protocols; print how the rig recovers.

    The lifts run in real time, about 25 s per lift, and are stored as a session in the folder of the results.
    The exit code is 4 if a fault was not detected, not named or not made safe within a second, if an object
    was dropped, or if the next lift did not run.

    Examples:
      rig benchmark faults

      rig benchmark faults --case arm --case "gripper: silent" --json

      rig benchmark faults --bench slow.toml

    """
    bench = load_bench(options.bench)
    if bench.fakes is None or bench.fakes.control is not None:
        raise InputError(
            f"bench '{bench.name}': faults are injected into fakes that the benchmark starts itself; give a "
            "bench of real drivers with an empty [fakes] table, as wire"
        )
    wanted = [c for c in CASES if not options.cases or any(text.lower() in c.name for text in options.cases)]
    if not wanted:
        names = ", ".join(case.name for case in CASES)
        raise InputError(f"no case contains {' or '.join(options.cases or [])}; cases are: {names}")

    def show(row: FaultRow) -> None:
        text = "; then: ".join(row.outcomes) or "no fault was noticed"
        run.progress(row.number, len(wanted), f"{row.fault}: {text}")

    rows = run_faults(run.results_folder, wanted, show, bench)
    title = f"SIMULATED bench '{bench.name}': from the fault to the rig's stop, from there to standstill"
    return Report((table_of(title, FaultRow, rows, left=6),), judge_faults(rows), "the rig")


def judge_faults(rows: Sequence[FaultRow]) -> tuple[Measured, ...]:
    """Return the limits. Whether finished lifts are whole on disk was checked by `run_faults`."""
    return (
        at_most("objects dropped", sum(row.dropped for row in rows), 0),
        at_most("lifts after a fault that did not run", sum(not row.recovered for row in rows), 0),
        at_most("faults not seen, not named or not made safe", sum(not row.passed for row in rows), 0),
    )


STUDY = Study("faults", FaultsOptions, measure, "faults", shared=("out",), keeps_results=True)
