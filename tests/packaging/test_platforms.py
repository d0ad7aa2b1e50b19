"""On Windows and macOS, as far as a system can be told that it has less."""

import subprocess
import sys
from pathlib import Path

import pytest
from withheld import environment

ELSEWHERE = Path(__file__).with_name("elsewhere.py")

# What Windows' Python has not, and macOS'.
WINDOWS = (
    "os.fork os.pwrite os.pread os.preadv os.pwritev os.nice os.getuid os.openpty "
    "os.sysconf os.posix_fallocate os.sched_getaffinity os.sched_setaffinity "
    "os.sched_getscheduler os.sched_setscheduler os.sched_getparam os.SCHED_FIFO "
    "signal.SIGXFSZ signal.setitimer select.poll socket.send_fds socket.recv_fds"
)
MACOS = (
    "os.posix_fallocate os.sched_getaffinity os.sched_setaffinity os.sched_setscheduler "
    "os.fork os.sched_getscheduler os.sched_getparam os.SCHED_FIFO"
)


@pytest.mark.long
@pytest.mark.parametrize(
    "modules, attributes",
    [(("fcntl", "resource", "termios"), WINDOWS), ((), MACOS)],
    ids=["windows", "macos"],
)
def test_a_system_that_has_less(modules, attributes, tmp_path):
    """All modules are imported; files are read, replayed, recorded and reconstructed."""
    run = subprocess.run(
        [sys.executable, ELSEWHERE],
        env=environment(tmp_path, modules, attributes.split()),
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert run.returncode == 0 and run.stdout.endswith("ok\n"), run.stderr[-3000:]
