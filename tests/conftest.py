"""Settings and fixtures of all tests: how many cases run, where real data is, and light simulated benches."""

import gc
import os
import signal
import sys
from collections.abc import Callable

# BLAS threads of several processes wait for each other, which makes a loaded host ten times slower.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Tests start hundreds of programs, which import faster from bytecode.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from hypothesis.internal.charmap import charmap
from markupsafe import Markup

from end_to_end import is_end_to_end, is_heavy
from rig.config import BenchConfig
from rig.config.write import write_bench
from rig.experiments.lift_plan import TrialSettings
from rig.experiments.trial import run_trial
from rig.tactile.estimators import choose_estimator
from rig.tactile.slip.all_loops import compile_all
from rig.terminal import screen
from support.benches import lighter, short_phases
from support.fuzz import PROFILE
from support.shared import made_once

sys.dont_write_bytecode = False  # this process has read the variable at its start

# Background jobs and nohup ignore these signals, and programs that tests start would ignore them too.
signal.signal(signal.SIGHUP, signal.SIG_DFL)
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

pytest_plugins = ("rig.contract_checks", "support.side_by_side", "support.cpu_limit", "support.drawn_sensor")

# After a time without output the name of a phase is printed, so the output would depend on the host's load.
screen.SILENT_S = 600.0

FUZZ_CASES, ALL_FUZZ_CASES = 60, 300
"""Damaged inputs per format, without and with --all."""
PROPERTY_CASES, ALL_PROPERTY_CASES = 8, 60
"""Examples of a property test that sets no number itself, without and with --all."""
LONGEST_ID = 100
"""Longest text that is part of a test's name, characters."""
ROOT = Path(__file__).parent.parent


def pytest_configure(config: pytest.Config) -> None:
    """Set the number of hypothesis examples. They have no time limit, because the host may be loaded."""
    every = config.getoption("--all")
    quiet = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.function_scoped_fixture]
    cases = config.getoption("--fuzz-cases") or (ALL_FUZZ_CASES if every else FUZZ_CASES)
    settings.register_profile(
        PROFILE, max_examples=cases, deadline=None, suppress_health_check=quiet, database=None
    )
    examples = ALL_PROPERTY_CASES if every else PROPERTY_CASES
    settings.register_profile("rig", max_examples=examples, deadline=None)
    settings.load_profile("rig")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--fuzz-cases", type=int, metavar="N", help="damaged inputs per format")
    parser.addoption(
        "--all",
        action="store_true",
        help=f"also run the tests marked 'heavy', the fuzz tests with {ALL_FUZZ_CASES} inputs each, and the "
        f"property tests with {ALL_PROPERTY_CASES} examples each",
    )


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """Replace a long parameter in a test's name by its length: workers exchange the names of all tests."""
    if isinstance(val, str | bytes) and len(val) > LONGEST_ID:
        return f"{argname} of {len(val)}"
    return None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Without --all, deselect heavy tests, unless they are end-to-end or named on the command line."""
    if config.getoption("--all"):
        return
    named = any("::" in argument for argument in config.args)
    chosen = [item for item in items if named or is_end_to_end(item) or not is_heavy(item)]
    config.hook.pytest_deselected(items=[item for item in items if item not in set(chosen)])
    items[:] = chosen


@pytest.hookimpl(trylast=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """Make before the workers start what each would make within the time of a test.

    These are the estimator's loops, of which a message is printed if they take time, and Hypothesis' table of
    characters: 1.8 s of CPU time at the first text that is drawn after an installation.
    """
    if not hasattr(session.config, "workerinput"):
        compile_all()
        charmap()


@pytest.fixture(scope="session", autouse=True)
def _own_memory(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Store states of hands and replays in a temporary folder instead of the user's."""
    os.environ["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))


def pytest_collection_finish() -> None:
    """Exclude the collected tests from later garbage collections.

    A collection stops all threads, also those of simulated devices. With all tests it takes at least
    0.15 s, in which a device misses its time limits.
    """
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def cases(pytestconfig: pytest.Config) -> Callable[[int], int]:
    """Return the number of cases of a seeded loop: all with --all, a twentieth without."""
    return lambda count: count if pytestconfig.getoption("--all") else count // 20


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real recordings: RIG_TEST_DATA, by default ../shared/data beside the project."""
    folder = Path(os.environ.get("RIG_TEST_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no real data at {folder}: set RIG_TEST_DATA")
    return folder


@pytest.fixture(scope="session")
def real_clips() -> Path:
    """The folder of labelled real clips that `rotation_clips/rebuild.py` makes: RIG_CLIPS."""
    folder = Path(os.environ.get("RIG_CLIPS", "no clips are given"))
    if not folder.is_dir():
        pytest.skip("no labelled real clips: make them with rotation_clips/rebuild.py and set RIG_CLIPS")
    return folder


@pytest.fixture(scope="session")
def light_bench() -> BenchConfig:
    """The simulated bench with half the frames, which reduces only the precision of an estimate."""
    return lighter()


@pytest.fixture(scope="session")
def light_bench_file(tmp_path_factory: pytest.TempPathFactory, light_bench: BenchConfig) -> Path:
    """The file of `light_bench`, for `--bench`."""
    file = tmp_path_factory.mktemp("bench") / "light.toml"
    write_bench(file, light_bench)
    return file


@pytest.fixture
def quick_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write pages with empty figures, whose drawing takes half of a page's time."""

    def empty(figure: object, alt: str) -> Markup:
        return Markup('<svg role="img" aria-label="{}" fill="var(--ink)"></svg>').format(alt)

    for name in ("rig.report.parts.drawn_svg", "rig.calibrate.charts.svg"):
        monkeypatch.setattr(name, empty)


@pytest.fixture
def quick_pages(quick_figures: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Write pages with empty figures and without films."""
    monkeypatch.setattr("rig.report.explored.lift_film", lambda *_: None)


@pytest.fixture(scope="session")
def one_lift(tmp_path_factory: pytest.TempPathFactory, light_bench: BenchConfig) -> Path:
    """A trial of one lift of the toothbrush on `light_bench`, estimated by slip. To be read only."""
    settings = TrialSettings(light_bench, 0, choose_estimator("slip"))
    with short_phases():
        return made_once(tmp_path_factory, "one_lift", lambda to: run_trial(to, settings, ["t2"], lifts=1))


@pytest.fixture(scope="session")
def two_lifts(tmp_path_factory: pytest.TempPathFactory, light_bench: BenchConfig) -> Path:
    """A trial of two lifts of the toothbrush on `light_bench`, estimated by pca. To be read only."""
    settings = TrialSettings(light_bench, 0, choose_estimator("pca"))
    with short_phases():
        return made_once(tmp_path_factory, "two_lifts", lambda to: run_trial(to, settings, ["t2"], lifts=2))
