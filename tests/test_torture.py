"""A small part of ``make torture``: runs killed at any step of their writes, full disks, damaged files."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks processes, which this system cannot")
def test_nothing_wrong_nothing_lost_no_traceback():
    command = [sys.executable, str(Path(__file__).with_name("torture.py")), "--kills", "30", "--damages", "8"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=1200)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1].startswith("0 faults")
    killed = [line.split() for line in done.stdout.splitlines() if " kill " in line or " full " in line]
    assert sum(int(number) for number, *_ in killed) >= 30
