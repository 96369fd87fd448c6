"""Kernels of a run of notebooks, forked from one process: imports take most of the time in which a kernel starts."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

from jupyter_client import AsyncKernelManager
from jupyter_client.provisioning import LocalProvisioner

# What a kernel says of itself: errors of a page reach us as exceptions. One that is told to end can close its sockets
# before its last answer is sent, which Tornado would print as a traceback.
_LOGGERS = {"loggers": {name: {"level": "CRITICAL"} for name in ("tornado", "asyncio")}}
QUIET = ["--log-level=CRITICAL", f"--Application.logging_config={_LOGGERS}"]


@contextlib.contextmanager
def forked() -> Iterator[type[AsyncKernelManager]]:
    """Give the class of managers whose kernels are forked; where a fork is not safe, of kernels that start by themselves."""
    if not sys.platform.startswith("linux"):
        yield AsyncKernelManager
        return
    server = _Server()

    class Provisioner(LocalProvisioner):
        async def launch_kernel(self, cmd: list[str], **kwargs: Any) -> Any:
            self.cwd = kwargs.get("cwd") or os.getcwd()
            arguments = cmd[cmd.index("ipykernel_launcher") :]
            self.process = server.fork(arguments, str(self.cwd), kwargs.get("env") or dict(os.environ))
            self.pid = self.pgid = self.process.pid
            return self.connection_info

    class Manager(AsyncKernelManager):
        def __init__(self, **kwargs: Any) -> None:
            super().__init__(**kwargs)
            self.provisioner = Provisioner(kernel_spec=self.kernel_spec, parent=self)

    try:
        yield Manager
    finally:
        server.close()


class _Server:
    """The process that kernels are forked from, started with the first of them."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None

    def fork(self, arguments: list[str], folder: str, environment: dict[str, str]) -> _Fork:
        """Start a kernel; one at a time."""
        with self._lock:
            if self._process is None:
                self._start()
            description = {"arguments": arguments, "folder": folder, "environment": environment}
            try:
                self._connection.write(json.dumps(description) + "\n")
                self._connection.flush()
                answer = self._connection.readline()
            except OSError:
                answer = ""
        if not answer:
            raise RuntimeError("the process that starts the notebooks has ended by itself; run again")
        return _Fork(int(answer), self._process)

    def _start(self) -> None:
        ours, theirs = socket.socketpair()
        with ours, theirs:
            command = [sys.executable, "-P", "-m", "artifact.book.fork_server", str(theirs.fileno())]
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, pass_fds=[theirs.fileno()], start_new_session=True
            )
            self._connection = ours.makefile("rw")

    def close(self) -> None:
        """End the process: it has nobody left to serve."""
        if self._process is not None:
            with contextlib.suppress(OSError):
                self._connection.close()
            self._process.wait()


class _Fork:
    """A process that is a child of another: what is used of :class:`subprocess.Popen`."""

    stdin = stdout = stderr = None

    def __init__(self, pid: int, parent: subprocess.Popen[bytes]) -> None:
        self.pid, self.returncode, self._parent = pid, None, parent

    def poll(self) -> int | None:
        """Return 1 once the process or its parent, without which it ends too, has ended: how is not known here."""
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            self.returncode = 1
        if self._parent.poll() is not None:
            self.returncode = 1
        return self.returncode

    def wait(self) -> int:
        while self.poll() is None:
            time.sleep(0.02)
        return 1

    def send_signal(self, number: int) -> None:
        os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)
