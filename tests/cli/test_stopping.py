"""Signals: the first starts the safe end, the second stops at once, further ones are ignored."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from support.command_line import refusal
from support.waiting import until

AtTerminal = Callable[[list[str], int], Any]
CODE = """if True:
    import sys, time
    from drivers.errors import OperatorStopError
    from rig.cli.common import say, stop_on_signals
    stop_on_signals()
    log = open({log!r}, "w", buffering=1)
    try:
        log.write("working\\n"); time.sleep(30)
    except OperatorStopError:
        try:
            say("still printing")
            log.write("teardown\\n"); time.sleep({teardown_s}); log.write("made safe\\n")
        except OperatorStopError:
            log.write("stopping\\n"); time.sleep(1.0); log.write("stands\\n")
"""


def wait_for(log: Path, text: str) -> None:
    until(lambda: log.exists() and text in log.read_text(), 120.0)


def started(log: Path, teardown_s: float = 0.3, code: str = CODE, **settings: Any) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", code.format(log=str(log), teardown_s=teardown_s)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, **settings)
    wait_for(log, "working")
    return process


def ended(process: subprocess.Popen[str], log: Path) -> tuple[str, str]:
    """Return what the process logged, a word per line, and what it printed."""
    _, error = process.communicate(timeout=120)
    return ", ".join(log.read_text().split("\n")).strip(", "), error


SAFE = "working, teardown, made safe"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_one_signal_ends_safely(tmp_path: Path, number: signal.Signals) -> None:
    process = started(tmp_path / "log")
    process.send_signal(number)
    assert ended(process, tmp_path / "log")[0] == SAFE


def test_second_signal_stops_at_once_and_further_ones_are_ignored(tmp_path: Path) -> None:
    log = tmp_path / "log"
    process = started(log, teardown_s=30)
    for before in ("working", "teardown", *["stopping"] * 15):
        wait_for(log, before)
        process.send_signal(signal.SIGINT)
        time.sleep(0.02)
    said, error = ended(process, log)
    assert said == "working, teardown, stopping, stands"
    assert "again stops at once, all motion included" in error


def test_closed_stderr_does_not_prevent_the_safe_end(tmp_path: Path) -> None:
    process = started(tmp_path / "log", code=CODE.replace('say("still printing")', ""))
    assert process.stderr is not None
    process.stderr.close()
    process.send_signal(signal.SIGTERM)
    process.wait(30)
    assert (tmp_path / "log").read_text() == "working\nteardown\nmade safe\n"


def test_lost_terminal_ends_safely_and_later_output_is_no_error(
    tmp_path: Path, at_terminal: AtTerminal
) -> None:
    log = tmp_path / "log"
    terminal = at_terminal([sys.executable, "-c", CODE.format(log=str(log), teardown_s=0.3)], 80)
    wait_for(log, "working")
    terminal.hang_up()
    assert terminal.process.wait(30) == 0
    assert log.read_text() == "working\nteardown\nmade safe\n"


def test_program_that_ignores_hangups_continues(tmp_path: Path) -> None:
    code = CODE.replace("sleep(30)", "sleep(0.5); log.write('done')")
    ignoring = {"preexec_fn": lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN) and None}
    process = started(tmp_path / "log", code=code, **ignoring)
    os.kill(process.pid, signal.SIGHUP)
    assert ended(process, tmp_path / "log")[0] == "working, done"


def test_real_bench_file_with_a_fakes_section_is_rejected_first(tmp_path: Path) -> None:
    from rig.config import load_bench
    from rig.config.models import BenchConfig
    from rig.config.write import write_bench

    values = load_bench("wire").model_dump()
    values["fakes"] = {"control": "127.0.0.1:9"}
    values["arm"]["host"], values["gripper"]["host"] = "192.0.2.10", "192.0.2.11"
    values["camera"]["address"] = "/dev/video4"
    write_bench(tmp_path / "bench.toml", BenchConfig.model_validate(values))
    done = refusal("trial", "--object", "wrench", "--bench", tmp_path / "bench.toml", "--out", tmp_path / "s")
    assert "according to [fakes] its devices are simulated" in done
    assert not (tmp_path / "s").exists()


STRUCK_AT_THE_END = """
import os, signal
from rig.cli.common import Exit, stop_on_signals
from rig.cli.main import _end

class Late:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)

late = Late()
stop_on_signals()
_end(("stopped by the operator",), "OperatorStopError", Exit.STOPPED)
"""


def test_ctrl_c_at_the_end_changes_neither_message_nor_exit_code() -> None:
    done = subprocess.run(
        [sys.executable, "-c", STRUCK_AT_THE_END], capture_output=True, text=True, timeout=120, check=False
    )
    assert (done.returncode, done.stderr) == (3, "rig: stopped by the operator\n")


def test_signal_during_the_clean_up_of_an_import_still_stops() -> None:
    """Python discards exceptions of such a callback, as of the one that removes a module's lock."""
    code = """if True:
        import os, signal, time, weakref
        from drivers.errors import OperatorStopError
        from rig.cli.common import stop_on_signals
        class Lock: pass
        names = {"os": os, "signal": signal}
        text = "def cb(_): os.kill(os.getpid(), signal.SIGINT)"
        exec(compile(text, "<frozen importlib._bootstrap>", "exec"), names)
        stop_on_signals()
        lock = Lock()
        watched = weakref.ref(lock, names["cb"])
        try:
            del lock
            time.sleep(20)
        except OperatorStopError:
            print("stopped")
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout == "stopped\n", done.stderr
    assert "ignored" not in done.stderr


AT_EVERY_LINE = """if True:
    import signal, sys
    from rig.cli import common, main as program

    def exit_code(first: int, gap: int) -> int | None:
        \"\"\"Run `rig --version`, Ctrl-C at line `first` and `gap` lines later; None: it ended before.\"\"\"
        lines = sent = 0
        def trace(frame, event, argument):
            nonlocal lines, sent
            if frame.f_code.co_filename not in (program.__file__, common.__file__):
                return None
            lines += event == "line"
            handled = signal.getsignal(signal.SIGINT) is not signal.default_int_handler
            if event == "line" and handled and sent < 2 and lines >= first + sent * gap:
                sent += 1
                signal.raise_signal(signal.SIGINT)
            return trace
        for number in (*common.STOPS, signal.SIGHUP):
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
        sys.settrace(trace)
        try:
            program.main()
        except SystemExit as end:
            return end.code if sent else None
        finally:
            sys.settrace(None)

    sys.argv = ["rig", "--version"]
    for gap in (1, 7):
        first = 1
        while (code := exit_code(first, gap)) is not None:
            assert code in (0, 3), (first, gap, code)
            first += 1
        assert first > 30, "the command has fewer lines than expected"
"""


@pytest.mark.heavy
def test_ctrl_c_at_any_line_of_the_command_line_ends_it_with_its_exit_code() -> None:
    done = subprocess.run([sys.executable, "-c", AT_EVERY_LINE], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
