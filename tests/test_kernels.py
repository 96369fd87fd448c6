"""Kernels that are forked from one process: as those that start by themselves, only sooner."""

import contextlib
import os
import signal
import subprocess
import sys
import time

import nbformat
import pytest
from jupyter_client import AsyncKernelManager
from nbclient import NotebookClient
from nbclient.exceptions import DeadKernelError

from artifact.book import kernels

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="kernels are forked on Linux only")


@pytest.fixture(scope="module")
def manager():
    with kernels.forked() as found:
        yield found


def answers(manager, folder, *sources, **options):
    """Run cells in a kernel; return what they print."""
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(source) for source in sources])
    client = NotebookClient(notebook, kernel_manager_class=manager, kernel_name="python3", **options)
    client.execute(cwd=str(folder))
    return ["".join(output.get("text", "") for output in cell.outputs).strip() for cell in notebook.cells]


def test_a_kernel_has_its_own_folder_environment_and_variables(manager, tmp_path, monkeypatch):
    monkeypatch.setenv("SAID", "first")
    first = answers(manager, tmp_path, "import os; kept = 1", "print(os.getcwd(), os.environ['SAID'], os.getppid())")
    monkeypatch.setenv("SAID", "second")
    second = answers(
        manager, "/", "import os", "print(os.getcwd(), os.environ['SAID'], os.getppid(), 'kept' in globals())"
    )
    assert first[1].split()[:2] == [str(tmp_path), "first"]
    assert second[1].split()[:2] == ["/", "second"]
    assert second[1].split()[2:] == [first[1].split()[2], "False"], "both come from one process"


def test_what_pages_import_is_there_when_a_kernel_starts(manager, tmp_path):
    there, plotted = answers(
        manager,
        tmp_path,
        "import sys; print({'numpy', 'pandas', 'matplotlib.pyplot', 'artifact.studies', 'torch'} & sys.modules.keys())",
        "import numpy as np; print((np.ones((300, 300)) @ np.ones((300, 300))).sum())",
    )
    assert eval(there) == {"numpy", "pandas", "matplotlib.pyplot", "artifact.studies"}
    assert plotted == "27000000.0"


@pytest.mark.parametrize("end", ["os._exit(3)", "os.kill(os.getpid(), 9)", "os.kill(os.getppid(), 9); time.sleep(60)"])
def test_a_kernel_that_dies_is_noticed_also_with_its_parent(tmp_path, end):
    with kernels.forked() as manager, pytest.raises(DeadKernelError):
        answers(manager, tmp_path, f"import os, time; {end}")


def test_nothing_is_left_and_a_server_that_died_is_told(tmp_path):
    with kernels.forked() as manager:
        parent, own = answers(manager, tmp_path, "import os; print(os.getppid())", "print(os.getpid())")
        os.kill(int(parent), signal.SIGKILL)
        with pytest.raises(
            RuntimeError, match=r"^the process that starts the notebooks has ended by itself; run again$"
        ):
            answers(manager, tmp_path, "1")
    with kernels.forked() as manager:
        parent, own = answers(manager, tmp_path, "import os; print(os.getppid())", "print(os.getpid())")
    assert_ended(int(parent), int(own))


def assert_ended(*processes):
    for pid in processes:
        deadline = time.monotonic() + 20
        while os.path.exists(f"/proc/{pid}") and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not os.path.exists(f"/proc/{pid}")


def test_a_run_that_is_killed_leaves_no_kernel(tmp_path):
    cell = (
        "import os, pathlib, time; pathlib.Path('pids').write_text(f'{os.getppid()} {os.getpid()} .'); time.sleep(600)"
    )
    code = f"""if True:
        import nbformat
        from nbclient import NotebookClient
        from artifact.book import kernels
        notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell({cell!r})])
        with kernels.forked() as manager:
            NotebookClient(notebook, kernel_manager_class=manager, kernel_name="python3").execute(cwd={str(tmp_path)!r})
    """
    run, written = subprocess.Popen([sys.executable, "-c", code]), tmp_path / "pids"
    while not (written.exists() and written.read_text().endswith(".")):
        assert run.poll() is None
        time.sleep(0.05)
    run.kill()
    run.wait()
    assert_ended(*map(int, written.read_text().split()[:2]))


CLOSED_TOO_SOON = """
import os, zmq
send = get_ipython().kernel._publish_status
def send_and_fail(status, channel, parent=None):
    send(status, channel, parent)
    if channel == "control":
        raise zmq.ZMQError(zmq.ENOTSOCK)
get_ipython().kernel._publish_status = send_and_fail
print(os.getpid())
"""


@pytest.mark.parametrize("kind", [kernels.forked, lambda: contextlib.nullcontext(AsyncKernelManager)])
def test_a_kernel_that_ends_before_its_last_answer_is_sent_prints_nothing(tmp_path, capfd, kind):
    with kind() as manager:
        for quiet in (False, True):
            (pid,) = answers(manager, tmp_path, CLOSED_TOO_SOON, extra_arguments=kernels.QUIET if quiet else [])
            assert_ended(int(pid))
            said = capfd.readouterr().err
            assert said == "" if quiet else "Socket operation on non-socket" in said


def test_threads_that_wait_are_told_to_sleep_soon_before_they_start():
    code = """
import os, sys
from artifact.commands import cli
assert not {"numpy", "torch"} & {*sys.modules}, "too late to tell them"
try:
    cli.main(["--help"])
except SystemExit:
    print("told", os.environ["OMP_WAIT_POLICY"], os.environ["OPENBLAS_THREAD_TIMEOUT"])
"""
    environment = {name: value for name, value in os.environ.items() if "THREAD" not in name and "OMP" not in name}
    for own, told in (({}, "PASSIVE 18"), ({"OPENBLAS_THREAD_TIMEOUT": "4"}, "PASSIVE 4")):
        done = subprocess.run(
            [sys.executable, "-c", code], env=environment | own, capture_output=True, text=True, check=False
        )
        assert done.stdout.splitlines()[-1:] == [f"told {told}"], done.stderr
