"""What Windows and macOS have not, taken away from this process: a simulation of them on Linux.

Runs before clradar is imported, after the libraries that it uses, which know the real system.
"""

import importlib
import os
import signal
import socket
import sys
from types import ModuleType
from typing import ClassVar

LIBRARIES = (
    "asyncio ctypes h5py matplotlib.pyplot multiprocessing.resource_tracker numpy PIL.Image "
    "pyopencl rich.console rich.progress scipy.ndimage scipy.optimize scipy.spatial.transform "
    "skimage.measure skimage.metrics subprocess tempfile trimesh typer uuid xarray dask.array "
    "dask.distributed pylops"
)
MISSING = {
    "darwin": {os: "sched_getaffinity sched_setaffinity posix_fallocate"},
    "win32": {
        os: (
            "fork forkpty register_at_fork sched_getaffinity sched_setaffinity posix_fallocate "
            "fchmod fchown getuid geteuid getpgid killpg mkfifo setsid O_DIRECTORY O_NONBLOCK "
            "O_NOFOLLOW pread pwrite uname wait3 wait4"
        ),
        signal: (
            "alarm pthread_sigmask setitimer sigwait SIGALRM SIGCHLD SIGHUP SIGPIPE "
            "SIG_BLOCK SIG_SETMASK SIG_UNBLOCK"
        ),
        socket: "AF_UNIX send_fds recv_fds",
    },
}
MODULES = {
    "darwin": "",
    "win32": "fcntl grp posix pty pwd readline resource syslog termios",
}


class FileLock:
    """What filelock has for Windows, as far as it is used: it asks for the real system itself."""

    held: ClassVar[set[str]] = set()

    def __init__(self, lock_file: os.PathLike[str], **settings: object) -> None:
        self.lock_file = os.path.realpath(lock_file)

    def acquire(self) -> None:
        if self.lock_file in self.held:
            raise TimeoutError
        self.held.add(self.lock_file)
        open(self.lock_file, "ab").close()

    def release(self) -> None:
        self.held.remove(self.lock_file)


def become(system: str) -> None:
    """Take away what `system`, "win32" or "darwin", has not; this process never gets it back."""
    for name in LIBRARIES.split():
        importlib.import_module(name)
    assert not any(name.split(".")[0] == "clradar" for name in sys.modules)
    for module, names in MISSING[system].items():
        for name in names.split():
            if hasattr(module, name):  # some Pythons lack some
                delattr(module, name)
    for name in MODULES[system].split():
        sys.modules[name] = None  # type: ignore[assignment]
    if system == "win32":
        filelock = ModuleType("filelock")
        soft = type("SoftFileLock", (FileLock,), {})
        vars(filelock).update(FileLock=FileLock, SoftFileLock=soft, Timeout=TimeoutError)
        sys.modules["filelock"] = filelock
    sys.platform = system
