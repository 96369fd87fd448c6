"""The process that kernels are forked from: it has imported what every page imports, and then waits.

Run as ``python -P -m artifact.book.fork_server DESCRIPTOR`` by :mod:`artifact.book.kernels`. Each line that comes through
the socket ``DESCRIPTOR`` describes a kernel, and is answered by its process id; at the end of the socket the server ends.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
import warnings
from typing import Any


def wait_for_requests(connection: socket.socket) -> dict[str, Any] | None:
    """Fork for each request; returns the request in the fork, and nothing in the server, once nobody asks any more."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the system forgets kernels that have ended
    for line in connection.makefile():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of threads: those of NumPy's library, which survives a fork
            pid = os.fork()
        if pid == 0:
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            connection.close()
            return json.loads(line)
        connection.sendall(f"{pid}\n".encode())
    return None


def main() -> None:
    """Import what pages import, serve, and in a fork become a kernel."""
    import matplotlib.pyplot  # noqa: F401
    import matplotlib_inline.backend_inline  # noqa: F401
    from ipykernel import kernelapp

    import artifact.pages
    import artifact.pages.scope
    import artifact.studies  # noqa: F401

    request = wait_for_requests(socket.socket(fileno=int(sys.argv[1])))
    if request is not None:
        os.setsid()  # a signal to its group reaches the processes that the kernel starts, and no other kernel
        os.chdir(request["folder"])
        os.environ.clear()
        os.environ.update(request["environment"])
        # A kernel ends with the server, also that of a run that was killed. The variable for it was read at import.
        sys.argv = [*request["arguments"], f"--IPKernelApp.parent_handle={os.getppid()}"]
        kernelapp.launch_new_instance()


if __name__ == "__main__":
    main()
